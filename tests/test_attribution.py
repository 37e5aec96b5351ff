"""Covariances of parts, shares of variance and fireflies with their errors, and Sobol' indices, against known laws."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc import scenes
from jaxmc.analysis.attribution import FireflyParts, firefly_parts, sobol_indices, variance_parts
from jaxmc.integration.covariance import GROUPS

N = 200_000


def three(u):
    """Return three dependent numbers of different size."""
    return jnp.stack([u[0], 2.0 * u[0] * u[1], 3.0 + u[1] ** 2])


def covariance(f, n=N, **options):
    return mc.integrate(f, n=n, tallies={"parts": mc.Covariance()}, **options)["parts"]


@pytest.mark.parametrize("n", [100, 100_003])
def test_the_covariance_is_that_of_the_samples(n):
    f = mc.Integrand(three, 2)
    found, drawn = covariance(f, n), mc.draw(f, n=n).value.astype(np.float64)
    assert found.n.sum() == n and len(found.n) == GROUPS
    assert np.allclose(found.total_mean, drawn.mean(0), rtol=1e-6)
    assert np.allclose(found.covariance, np.cov(drawn.T), rtol=2e-6, atol=1e-9)


@pytest.mark.slow
def test_large_offsets_and_sizes_lose_nothing():
    f = mc.Integrand(lambda u: jnp.stack([1e4 + u[0], 1e25 * (u[0] + u[1])]), 2)
    found = covariance(f)
    assert found.covariance[0, 0] == pytest.approx(1 / 12, rel=0.02) and found.nonfinite == 0
    assert found.covariance[0, 1] == pytest.approx(1e25 / 12, rel=0.03)
    assert found.covariance[1, 1] == pytest.approx(1e50 / 6, rel=0.02)


@pytest.mark.slow
def test_values_that_are_not_finite_are_counted():
    f = mc.Integrand(lambda u: jnp.stack([jnp.where(u[0] < 0.01, jnp.inf, 1.0), u[0]]), 1)
    found = covariance(f, 10_000)
    assert found.nonfinite == np.isinf(mc.draw(f, n=10_000).value).sum() > 0
    assert not np.isfinite(found.covariance[0, 0])


@pytest.mark.slow
def test_uneven_parts_of_the_work_give_the_same_matrix():
    tally, f = mc.Covariance(), mc.Integrand(three, 2)
    x = jnp.asarray(mc.draw(f, n=64 * 960).value.reshape(64, 960, 3))
    records = []
    for start, stop in ((0, 5), (5, 6), (6, 64), (64, 64)):
        rows = jnp.arange(64)[:, None]
        valid = jnp.broadcast_to((rows >= start) & (rows < stop), (64, 960))
        records.append({k: np.asarray(v)[None] for k, v in tally.reduce(x, valid, (0, 1)).items()})
    one = tally.init(records[0])
    for record in records:
        tally.add(one, {k: v[0] for k, v in record.items()})
    some = []
    for pair in (records[:1], records[1:]):
        some.append(tally.init(records[0]))
        for record in pair:
            tally.add(some[-1], {k: v[0] for k, v in record.items()})
    merged = tally.result(tally.merge(*some))
    assert np.allclose(merged.covariance, tally.result(one).covariance, rtol=1e-12)
    assert np.allclose(merged.covariance, np.cov(np.asarray(x, np.float64).reshape(-1, 3).T), rtol=1e-5)


@pytest.mark.slow
def test_chunks_and_workers_do_not_matter():
    runs = [covariance(mc.Integrand(three, 2), 150_000, chunk=c, workers=w) for c, w in ((1 << 16, 1), (1 << 18, 2))]
    assert np.array_equal(runs[0].scatter, runs[1].scatter)


@pytest.mark.slow
def test_a_family_has_a_matrix_for_each_integral_and_the_noise_is_theirs_alone():
    def f(u, item):
        return jnp.stack([100.0 * item + u[0], u[0] * u[1]])

    found = mc.integrate_each(mc.Integrand(f, 2), 50, n=300, tallies={"parts": mc.Covariance()})["parts"]
    assert found.each and found.covariances.shape == (50, 2, 2) and np.all(found.n == 150)
    assert found.covariances[:, 0, 0] == pytest.approx(1 / 12, rel=0.2)
    assert found.covariance[0, 0] == pytest.approx(1 / 12, rel=0.05)  # not 100^2 times something
    assert found.covariance[0, 1] == pytest.approx(1 / 24, rel=0.05)


def uneven(u, item):
    """Return two parts whose sizes differ a hundredfold from integral to integral."""
    size = jnp.where(item % 10 == 0, 100.0, 1.0)
    return jnp.stack([size * u[0], u[0] + u[1]])


def test_what_integrals_differ_by_is_no_error():
    z, f = [], mc.Integrand(uneven, 2)
    # Var: (1000 / 12, 1 / 6) on average over the integrals, covariance 10.9 / 12.
    exact = np.array([(0.1 * 1e4 + 0.9) / 12, 1 / 6, 10.9 / 12])
    total = exact[0] + exact[1] + 2 * exact[2]
    share = (exact[0] + exact[2]) / total
    for key in range(20):
        parts = variance_parts(mc.integrate_each(f, 40, n=64, key=key, tallies={"c": mc.Covariance()})["c"])
        z.append([(parts.share[0] - share) / parts.share_stderr[0], (parts.total - total) / parts.total_stderr])
    z = np.array(z)
    assert np.abs(z).max() < 6.0 and np.abs(z.mean(0)).max() < 1.2 and np.all((0.6 < z.std(0)) & (z.std(0) < 1.6))
    with pytest.raises(ValueError, match="4 samples"):
        variance_parts(mc.integrate_each(f, 40, n=1, tallies={"c": mc.Covariance()})["c"])


def check_shares(parts, whole_variance):
    """Check that the shares make up the variance of the sum, and the variance of another run."""
    assert parts.share.sum() == pytest.approx(1.0, abs=1e-12)
    assert (parts.variance + parts.covariance).sum() == pytest.approx(parts.total, rel=1e-12)
    assert abs(parts.total - whole_variance) <= 5.0 * parts.total_stderr
    assert parts.total_stderr <= 0.02 * parts.total


def test_shares_are_exact_and_their_errors_hold():
    # Var(u0) = 1/12, and so on: Cov(u0, 2 u0 u1) = 1/12, Cov(u0, u1^2) = 0, Cov(2 u0 u1, u1^2) = 1/12.
    exact = np.array([[1 / 12, 1 / 12, 0], [1 / 12, 7 / 36, 1 / 12], [0, 1 / 12, 4 / 45]])
    share = exact.sum(0) / exact.sum()
    z = []
    for key in range(20):
        parts = variance_parts(covariance(mc.Integrand(three, 2), 20_000, key=key), ["a", "b", "c"])
        z.append((parts.share - share) / parts.share_stderr)
    z = np.array(z)
    # The jackknife has 31 degrees of freedom: the spread of z is that of Student's law, 1.03.
    assert np.abs(z).max() < 6.0 and 0.75 < z.std() < 1.4
    check_shares(parts, exact.sum())
    assert np.allclose(parts.correlation[0, 1], (1 / 12) / np.sqrt(7 / 36 / 12), atol=0.02)
    assert "sum" in str(parts) and parts.rows()[-1][0] == "sum" and len(parts.rows()) == 4


def test_shares_without_covariances_are_seen():
    parts = variance_parts(covariance(mc.Integrand(three, 2)))
    mutant = parts._replace(covariance=np.zeros(3), share=parts.variance / parts.total)
    with pytest.raises(AssertionError):
        check_shares(mutant, parts.total)
    alone = parts.variance.sum()
    other = parts._replace(total=alone, covariance=np.zeros(3), share=parts.variance / alone)
    with pytest.raises(AssertionError):
        check_shares(other, parts.total)


def rare(u):
    """Return a calm part, a part that is 100 with probability 0.01, and one that is 50 with probability 0.03."""
    return jnp.stack([u[0], jnp.where(u[1] < 0.01, 100.0, 0.0), jnp.where(u[1] > 0.97, 50.0, 0.0)])


def test_fireflies_are_traced_to_their_parts():
    tallies = {"fireflies": mc.Covariance(of=FireflyParts(40.0))}
    found = firefly_parts(mc.integrate(rare, dim=2, n=N, tallies=tallies)["fireflies"], ["calm", "few", "more"])
    assert found.fireflies == found.count.sum() and found.count[0] == 0 and found.n == N
    assert found.share_interval.lower[1] < 0.25 < found.share_interval.upper[1]
    energy = np.array([0.04 * 0.5, 1.0, 1.5]) / 2.52
    assert np.all(np.abs(found.energy - energy) < 5.0 * found.energy_stderr) and found.energy_stderr.max() < 0.02
    assert found.energy.sum() == pytest.approx(1.0) and found.rows()[0][0] == "more" and "few" in str(found)


def test_what_cannot_be_divided_is_refused():
    with pytest.raises(ValueError, match="one array for each sample"):
        mc.integrate(lambda u: u[0], dim=1, n=100, tallies={"parts": mc.Covariance()})
    found = covariance(mc.Integrand(three, 2), 1000)
    with pytest.raises(ValueError, match="expected 3 names"):
        variance_parts(found, ["a"])
    with pytest.raises(ValueError, match="FireflyParts"):
        firefly_parts(found)
    with pytest.raises(ValueError, match="no firefly"):
        firefly_parts(mc.integrate(rare, dim=2, n=1000, tallies={"f": mc.Covariance(of=FireflyParts(1e3))})["f"])
    with pytest.raises(ValueError, match="two groups of two"):
        variance_parts(covariance(mc.Integrand(three, 2), 1))
    with pytest.raises(ValueError, match="threshold"):
        FireflyParts(0.0)


# -------------------------------------------------------------------------------------------------- Sobol' indices


def ishigami(u):
    x = np.pi * (2.0 * u - 1.0)
    return jnp.sin(x[0]) + 7.0 * jnp.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * jnp.sin(x[0])


def ishigami_indices():
    """Ishigami & Homma (1990): first-order and total indices of the three inputs, and the variance."""
    a, b = 7.0, 0.1
    first = np.array([0.5 * (1 + b * np.pi**4 / 5) ** 2, a**2 / 8, 0.0])
    both = b**2 * np.pi**8 * (1 / 18 - 1 / 50)
    variance = first.sum() + both
    return first / variance, (first + both * np.array([1, 0, 1])) / variance, variance


def check_indices(found, first, total, variance):
    assert np.all(np.abs(found.first - first) <= 5.0 * found.first_stderr) and found.first_stderr.max() < 0.01
    assert np.all(np.abs(found.total - total) <= 5.0 * found.total_stderr + 1e-6) and found.total_stderr.max() < 0.01
    assert abs(found.variance - variance) <= 5.0 * found.variance_stderr < 0.1 * variance


def test_indices_of_ishigami():
    f, names = mc.pick_freeze(ishigami, dim=3)
    assert names == ("u[0]", "u[1]", "u[2]") and f.dim == 6
    found = sobol_indices(covariance(f), names)
    check_indices(found, *ishigami_indices())
    assert found.rows()[0][0] in ("u[0]", "u[1]") and "first order" in str(found)
    # First-order for total indices, and indices of other groups, are seen.
    first, total, variance = ishigami_indices()
    for wrong in ((total, first, variance), (first[::-1], total, variance)):
        with pytest.raises(AssertionError):
            check_indices(found, *wrong)


@pytest.mark.slow
def test_groups_by_label():
    labels = ("film: x", "film: y", "event 1, polar")
    # (u0 + u1) u2 with groups {u0, u1} and {u2}: exact by hand.
    f = mc.Integrand(lambda u: (u[0] + u[1]) * u[2], 3, labels=labels)
    wide, names = mc.pick_freeze(f)
    assert names == ("film", "event 1")
    both = 7 / 6 / 3 - 0.25
    first = np.array([(1 / 6) / 4, 1 / 12]) / both
    check_indices(sobol_indices(covariance(wide), names), first, 1.0 - first[::-1], both)
    with pytest.raises(ValueError, match="all 3 coordinates are in the group"):
        mc.pick_freeze(f, group=lambda label: "all")
    with pytest.raises(ValueError, match="of one number"):
        covariance(mc.pick_freeze(mc.Integrand(three, 2))[0], 100)


# ----------------------------------------------------------------------------------------------------------- scenes

BOXES = {"cornell-box": {"bounces": 5}, "mirror-box": {"bounces": 8, "hide_emitters": True}}


@pytest.mark.slow
@pytest.mark.parametrize("by", ["bounce", "class", "technique"])
@pytest.mark.parametrize("name", BOXES)
def test_parts_make_up_the_variance_of_another_run(name, by):
    scene, camera = scenes.SCENES[name](width=48, height=32)
    pixels = camera.width * camera.height
    parts = mc.path_parts(scene, camera, by=by, **BOXES[name])
    n = {"cornell-box": 256, "mirror-box": 8192}[name]
    found = mc.integrate_each(parts, pixels, n=n, key=1, tallies={"parts": mc.Covariance()})["parts"]
    table = variance_parts(found, mc.part_names(parts))
    render = mc.render(scene, camera, spp=n, key=3, tallies={"luminance": mc.Moments(mc.luminance)}, **BOXES[name])
    moments = render["luminance"][0]
    other = moments.variance[..., 0]
    # Error of the mean of the pixels' variances, from their fourth moments.
    fourth = moments.central[2][..., 0] - moments.central[0][..., 0] ** 2
    stderr = np.sqrt((fourth / n).sum()) / pixels
    assert np.hypot(stderr, table.total_stderr) < 0.1 * table.total
    assert abs(table.total - other.mean()) <= 3.0 * np.hypot(stderr, table.total_stderr)
    assert table.share.sum() == pytest.approx(1.0)
    if name == "mirror-box" and by == "class":
        over_mirrors = [k for k, word in enumerate(table.names) if word.endswith("[DG] S+ L")]
        assert table.share[over_mirrors].sum() > 0.99
