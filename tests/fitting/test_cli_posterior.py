"""`vcavity fit --posterior` and `--compare`: files, JSON, and one line for what does not go."""

import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import netcdf_file

from fitting.cli import main
from tests.fitting.test_cli import GOLD, MIRROR, refusal

SHORT = ["--angle-range", "40:50"]


def run(capsys, *argv):
    status = main(["fit", GOLD, *MIRROR, *SHORT, *argv])
    out, err = capsys.readouterr()
    assert (status, err) == (0, "")
    return out


def test_the_nested_posterior_is_drawn_written_and_told(tmp_path, capsys):
    out = run(capsys, "--posterior", "--output", str(tmp_path))
    names = ["corner.png", "fit.json", "fit.png", "posterior.nc", "predictive.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert all(f"wrote {tmp_path / name}" in out for name in names)
    assert "nested: The draws are independent." in out
    told = json.loads((tmp_path / "fit.json").read_text())
    angle = told["posterior"]["parameters"]["angle"]
    assert angle["unit"] == "deg"
    low, high = angle["interval_95"]
    assert 44.9 < low < angle["median"] < high < 45.1
    assert told["parameters"]["angle"]["interval_95"][0][0] == pytest.approx(low, abs=0.03)
    with netcdf_file(tmp_path / "posterior.nc", mmap=False) as file:
        assert file.variables["angle_deg"].units == b"degree"
        np.testing.assert_allclose(np.median(file.variables["angle_deg"][:]), angle["median"], atol=1e-6)


def test_the_seed_makes_the_draws(tmp_path, capsys):
    def drawn(*argv):
        run(capsys, "--posterior", "--output", str(tmp_path), *argv)
        with netcdf_file(tmp_path / "posterior.nc", mmap=False) as file:
            return file.variables["angle_deg"][:].copy()

    first = drawn("--seed", "7")
    np.testing.assert_array_equal(drawn("--seed", "7"), first)
    assert not np.array_equal(drawn("--seed", "8"), first)


def test_an_ensemble_keeps_its_chain_and_goes_on_from_it(tmp_path, capsys):
    def steps():
        with h5py.File(tmp_path / "chain.h5") as file:
            return int(file["mcmc/stored"][0])

    out = run(capsys, "--posterior", "--sampler", "emcee", "--output", str(tmp_path))
    assert {"chain.h5", "trace.png", "corner.png"} <= {path.name for path in tmp_path.iterdir()}
    assert "autocorrelation times long" in out
    told, first = json.loads((tmp_path / "fit.json").read_text())["posterior"], steps()
    assert told["converged"]
    assert 0.1 < told["acceptance"] < 1
    run(capsys, "--posterior", "--sampler", "emcee", "--output", str(tmp_path))
    assert steps() == first  # It was long enough.


def test_comparison(tmp_path, capsys):
    out = run(capsys, "--compare", "--output", str(tmp_path))
    assert "verdict: the data speak for specular, full" in out
    told = json.loads((tmp_path / "fit.json").read_text())["comparison"]
    assert told["best"] == "specular, full"
    assert len(told["models"]) == 3


def test_options_that_do_not_go(tmp_path, capsys):
    fit = ["fit", GOLD, *MIRROR, "--output", str(tmp_path / "new")]
    assert "--seed has no effect: expected --posterior" in refusal(capsys, *fit, "--seed", "3")
    assert "--sampler has no effect: expected --posterior" in refusal(capsys, *fit, "--sampler", "emcee")
    assert "invalid choice: 'gibbs'" in refusal(capsys, *fit, "--posterior", "--sampler", "gibbs")
    config = tmp_path / "two.toml"
    config.write_text(
        f"""
        [[measurement]]
        file = "{GOLD}"
        name = "one"
        [[measurement]]
        file = "{GOLD}"
        name = "two"
        [scene]
        material = "specular"
        index = "Au-Johnson"
        [parameters.angle]
        """
    )
    said = refusal(capsys, "fit", "--config", str(config), "--compare", "--output", str(tmp_path / "new"))
    assert "several measurements" in said
    assert not (tmp_path / "new").exists()


def test_a_disk_that_is_full_costs_one_line_and_no_fit(tmp_path):
    """The process may write no file above 450 KiB: fit.png has room, the chain has not."""
    code = "import sys; from fitting.cli import main; sys.exit(main(sys.argv[1:]))"
    argv = ["fit", GOLD, *MIRROR, *SHORT, "--posterior", "--sampler", "emcee", "--output", str(tmp_path)]
    limited = ["bash", "-c", 'ulimit -f 450; exec "$@"', "limited", sys.executable, "-c", code, *argv]
    done = subprocess.run(limited, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "chain.h5: cannot write (File too large)" in line
    assert json.loads((tmp_path / "fit.json").read_text())["status"] == "converged"
    assert not list(Path(tmp_path).glob(".*"))
    assert not (tmp_path / "chain.h5").exists()
