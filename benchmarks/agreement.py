"""Whether two renderers agree: statistics of images of one scene, each rendered many times with different seeds.

Both renderers give K images, each of the same number of samples. Both pixel variances of the test are taken from the
spread over the seeds, so that the two sides enter alike: where they have the same distribution, z is symmetric about 0,
however skewed that distribution is. For normal images z is Student's t with 2K - 2 degrees of freedom; for heavy-tailed
ones it is narrower, so the same numbers for jaxmc against itself stand beside it as the standard that z has to meet.
Tiles, the means of 8 x 8 pixels, are closer to normal than pixels are, and see small differences of wide extent.
"""

import math

import numpy as np

TILE = 8


def compare(ours, theirs):
    """Compare two stacks of K images each, shape (K, height, width, 3); returns a dict of numbers."""
    return {
        "image": image_means(ours, theirs),
        "pixels": differences(ours, theirs),
        "tiles": differences(tiles(ours), tiles(theirs)),
        "variance_ratio_pixels": variance_ratio(ours, theirs),
        "variance_ratio_tiles": variance_ratio(tiles(ours), tiles(theirs)),
    }


def image_means(ours, theirs):
    """Return the mean over the image by channel, its standard error from the spread over seeds, and the difference."""
    a, b = (x.mean((1, 2), dtype=np.float64) for x in (ours, theirs))
    mean, error = zip(*((x.mean(0), x.std(0, ddof=1) / math.sqrt(len(x))) for x in (a, b)), strict=True)
    combined = np.hypot(*error)
    return {
        "ours": mean[0].tolist(),
        "ours_stderr": error[0].tolist(),
        "theirs": mean[1].tolist(),
        "theirs_stderr": error[1].tolist(),
        "relative_difference": ((mean[0] - mean[1]) / mean[1]).tolist(),
        "relative_stderr": (combined / mean[1]).tolist(),
        "z": ((mean[0] - mean[1]) / combined).tolist(),
    }


def differences(ours, theirs):
    """Return mean and standard deviation, with their errors, of z over pixels and channels, and its largest size.

    Pixels that never varied take no part in z: there, both sides must be equal.
    """
    count = len(ours)
    fixed = (np.ptp(ours, 0) == 0.0) & (np.ptp(theirs, 0) == 0.0)
    mean_a, mean_b = (x.mean(0, dtype=np.float64) for x in (ours, theirs))
    variance = _variance(ours) + _variance(theirs)
    z = (mean_a - mean_b)[~fixed] / np.sqrt(variance[~fixed] / count)
    # The channels of a pixel come from the same paths, so errors are those of one number for each pixel.
    by_pixel = np.where(fixed, 0.0, (mean_a - mean_b) / np.sqrt(np.where(fixed, 1.0, variance) / count))
    by_pixel = by_pixel[~fixed.all(-1)]
    root = math.sqrt(len(by_pixel))
    spread = z.std()
    freedom = 2 * count - 2
    return {
        "mean_z": z.mean(),
        "mean_z_error": by_pixel.mean(-1).std() / root,
        "std_z": spread,
        "std_z_error": (by_pixel**2).mean(-1).std() / root / (2.0 * spread),
        "std_z_of_normal_images": math.sqrt(freedom / (freedom - 2)),
        "largest_z": np.abs(z).max(),
        "values": z.size,
        "fixed": int(fixed.sum()),
        "fixed_and_different": int((np.abs(mean_a - mean_b) > 1e-6 * np.abs(mean_a))[fixed].sum()),
    }


def variance_ratio(ours, theirs):
    """Return (theirs / ours, error): the geometric mean over pixels of the ratio of the two variances over seeds."""
    a, b = (_variance(x).sum(-1) for x in (ours, theirs))
    both = (a > 0.0) & (b > 0.0)
    log = np.log(b[both] / a[both])
    ratio = math.exp(log.mean())
    return ratio, ratio * log.std() / math.sqrt(log.size)


def variance_by_own(images, own, spp):
    """Return (ratio, error): the variance over seeds against the variance that the renderer itself reports.

    ``own``, shape (K, height, width, 3), holds the variance of one sample in each image. The mean over pixels of the
    variance between images over that of all samples is 1 for independent samples of any distribution, heavy tails
    included: shuffling the samples of a pixel among its images changes nothing but the numerator.
    """
    count = len(images)
    between = spp * (count - 1) * _variance(images).sum(-1)
    within = (spp - 1) * own.sum((0, -1), dtype=np.float64)
    ratio = (between / (count - 1))[within > 0.0] / ((between + within) / (count * spp - 1))[within > 0.0]
    return ratio.mean(), ratio.std() / math.sqrt(ratio.size)


def tiles(images):
    """Return the means of tiles; rows and columns that do not fill a tile are left out."""
    count, height, width, channels = images.shape
    images = images[:, : height // TILE * TILE, : width // TILE * TILE]
    return images.reshape(count, height // TILE, TILE, width // TILE, TILE, channels).mean((2, 4), dtype=np.float64)


def _variance(images):
    return images.var(0, ddof=1, dtype=np.float64)
