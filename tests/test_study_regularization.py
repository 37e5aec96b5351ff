"""The study of regularization, in small."""

import json

import pytest

from jaxmc.studies import regularization


@pytest.mark.slow
def test_the_caustic_is_kept_by_regularization_and_lost_by_clamping(tmp_path):
    regularization.run(tmp_path, regularization.Settings(spp=1 << 14, width=48, height=32, progress=False))
    values = json.loads((tmp_path / "report.json").read_text())["values"]
    rows = {(row["cure"], row["N"]): row for row in values["cures"]}
    for name in regularization.CURES:
        long = rows[name, 2048]
        for n in (16, 128):
            row = rows[name, n]
            error = (row["its stderr"] ** 2 + long["its stderr"] ** 2) ** 0.5
            assert abs(row["of the caustic kept"] - long["of the caustic kept"]) <= 5.0 * error
    assert rows["clamped at 3", 128]["of the caustic kept"] < 0.1
    for name in ("regularized, pbrt", "regularized, opsr 0.1"):
        assert rows[name, 128]["of the caustic kept"] > 0.6
    with pytest.raises(ValueError, match="256 to"):
        regularization.Settings(spp=16)
