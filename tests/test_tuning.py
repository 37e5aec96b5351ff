"""The amount of a regularization with the least error, found by its derivative."""

import numpy as np
import pytest

import jaxmc as mc
from jaxmc import scenes


@pytest.mark.slow
def test_more_samples_want_less_blur_and_the_derivative_is_that_of_the_error():
    scene, camera = scenes.mirror_box(True, 12, 8)
    options = {"bounces": 3, "hide_emitters": True}
    reference = mc.luminance(np.asarray(mc.render(scene, camera, spp=1 << 15, key=1, **options).mean))
    found = [mc.tune_regularization(scene, camera, reference, N=N, n=1024, **options) for N in (16, 1024)]
    assert found[0].amount > found[1].amount + 0.1
    for N, tuned in zip((16, 1024), found, strict=True):
        assert np.isclose(tuned.error, tuned.squared_bias + tuned.variance / N, rtol=1e-3)
        # Far from the optimum the slope is large against its noise: the mean of two is that of the chord between them.
        (a, error_a, slope_a), (b, error_b, slope_b) = tuned.tried[:2]
        assert np.sign(error_b - error_a) == np.sign((b - a) * (slope_a + slope_b))
        assert 0.4 < (error_b - error_a) / (0.5 * (b - a) * (slope_a + slope_b)) < 2.5


def test_bad_input():
    scene, camera = scenes.mirror_box(True, 4, 4)
    with pytest.raises(ValueError, match="opsr, max_prev"):
        mc.tune_regularization(scene, camera, np.ones((4, 4)), N=16, bounces=1, rule="cone")
    with pytest.raises(ValueError, match="shape"):
        mc.tune_regularization(scene, camera, np.ones((3, 4)), N=16, bounces=1)
