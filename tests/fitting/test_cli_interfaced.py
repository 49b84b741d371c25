"""The command line of interfaced panels: what its options mean, what it refuses, a fit end to end."""

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Measurement
from fitting.cli import BAD_INPUT, main

EXAMPLES = Path(__file__).parents[2] / "examples" / "data"
CYAN, FLAT = str(EXAMPLES / "cyan-varnished-v75.csv"), str(EXAMPLES / "flat-cyan.csv")
NM = np.array([500.0, 600.0])
GLOSSY = ["--material", "interfaced", "--reflectance", "0.4"]


def refusal(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    assert main(argv) == BAD_INPUT
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    return err


class Asked(Exception):
    """The scene that a command would evaluate or fit."""


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> None:
    def evaluate(scene: vc.Scene, **_: Any) -> None:
        raise Asked(scene)

    def fit(scene: vc.Scene, measurement: Measurement, parameters: list, **_: Any) -> None:
        raise Asked(scene, {one.name: (one.lower, one.upper) for one in parameters})

    monkeypatch.setattr(vc, "reflectance_factor", evaluate)
    monkeypatch.setattr("fitting.cli.fit.fit", fit)


def assert_same(one: Any, other: Any) -> None:
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for mine, yours in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert mine.shape == yours.shape
        np.testing.assert_array_equal(mine, yours)


RHO = np.array([0.4, 0.4])


@pytest.mark.parametrize(
    ("options", "material"),
    [
        (["--index", "1.5"], vc.InterfacedLambertian(RHO, 1.5)),
        (["--index", "1"], vc.InterfacedLambertian(RHO, 1.0)),
        (["--index", "1.5+0j"], vc.InterfacedLambertian(RHO, 1.5)),
        (["--index", "clear.csv"], vc.InterfacedLambertian(RHO, np.array([1.5, 1.75]))),
        (
            ["--index", "PMMA-Sultanova"],
            vc.InterfacedLambertian(RHO, np.real(vc.materials.refractive_index("PMMA-Sultanova", NM))),
        ),
        (["--index", "1.5", "--polarization", "full"], vc.InterfacedLambertian(RHO, 1.5, polarization="full")),
        (
            ["--index", "1.5", "--specular", "excluded"],
            vc.InterfacedLambertian(RHO, 1.5, specular_included=False),
        ),
        (["--index", "1.5", "--layer", "0.9"], vc.InterfacedLambertian(RHO, 1.5, vc.ColoredLayer(0.9))),
        (
            ["--index", "1.5", "--layer", "ink.csv", "--layer-model", "berns", "--specular", "included"],
            vc.InterfacedLambertian(RHO, 1.5, vc.ColoredLayer(np.array([0.25, 0.75]), "berns")),
        ),
        (
            ["--index", "1.5", "--layer", "coarse.csv", "--resample"],
            vc.InterfacedLambertian(RHO, 1.5, vc.ColoredLayer(np.array([0.5, 0.75]))),
        ),
        (
            ["--index", "1.5", "--layer", "inks.csv", "--layer-column", "red", "--coverage", "0"],
            vc.InterfacedLambertian(RHO, 1.5, vc.Halftone(0.0, np.array([0.125, 1.0]))),
        ),
    ],
)
@pytest.mark.parametrize("command", ["predict", "fit"])
def test_options_make_the_material(
    asked: None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: str,
    options: list[str],
    material: vc.InterfacedLambertian,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("clear.csv").write_text("wavelength_nm,n,k\n500,1.5,1e-7\n600,1.75,0\n", encoding="utf-8")
    Path("ink.csv").write_text("wavelength_nm,transmittance\n500,0.25\n600,0.75\n", encoding="utf-8")
    Path("coarse.csv").write_text(
        "# reflectance_unit: percent\nwavelength_nm,reflectance\n400,25\n600,75\n", encoding="utf-8"
    )
    Path("inks.csv").write_text("wavelength_nm,red,blue\n500,0.125,1\n600,1,0.5\n", encoding="utf-8")
    Path("seen.csv").write_text("wavelength_nm,reflectance\n500,0.3\n600,0.4\n", encoding="utf-8")
    what = {"predict": ["--angle", "75", "--wavelengths", "500,600"], "fit": ["seen.csv"]}
    with pytest.raises(Asked) as caught:
        main([command, *what[command], *GLOSSY, *options])
    assert_same(caught.value.args[0].material, material)


@pytest.mark.parametrize(
    ("options", "limits"),
    [
        (["--material", "interfaced", "--index", "1.5"], (10, 180)),
        (["--material", "interfaced", "--index", "1.5", "--angle-range", "5:90"], (5, 90)),
        (["--material", "lambertian"], (5, 180)),
    ],
)
def test_narrow_grooves_under_an_interface_are_searched_on_demand(
    asked: None, options: list[str], limits: tuple[float, float]
) -> None:
    with pytest.raises(Asked) as caught:
        main(["fit", CYAN, "--reflectance", FLAT, *options])
    np.testing.assert_allclose(caught.value.args[1]["angle"], np.radians(limits), rtol=1e-15)


CLEAR = [*GLOSSY, "--index", "1.5"]


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (GLOSSY, "--material interfaced needs --index"),
        (["--material", "interfaced", "--index", "1.5"], "--material interfaced needs --reflectance"),
        ([*GLOSSY, "--index", "1.5+0.1j"], "--index 1.5+0.1j: k is 0.1 at 500 nm; expected k = 0"),
        ([*GLOSSY, "--index", "Au-Johnson"], "--index Au-Johnson: k is 1.87"),
        ([*GLOSSY, "--index", "0.9"], "--index 0.9: n is 0.9 at 500 nm; expected n ≥ 1"),
        ([*CLEAR, "--polarization", "separate"], "separate belongs to --material specular, not to interfaced"),
        ([*CLEAR, "--layer", "90"], "--layer 90: expected a fraction from 0 to 1: did you pass percent?"),
        ([*CLEAR, "--layer", FLAT], "no transmittance at 505 nm; expected a value at every wavelength used"),
        ([*CLEAR, "--layer", "gone.csv"], "gone.csv: no such file"),
        (
            [*CLEAR, "--layer", str(EXAMPLES / "metals-nasa-tn-d-5353.csv")],
            "expected --layer-column with one of: aluminum",
        ),
        (
            [*CLEAR, "--layer", "0.9", "--layer-column", "red"],
            "--layer-column has no effect: --layer 0.9 is a number",
        ),
        ([*CLEAR, "--layer", "0.9", "--layer-model", "thick"], "argument --layer-model: invalid choice: 'thick'"),
        ([*CLEAR, "--layer-model", "berns"], "--layer-model has no effect without --layer"),
        ([*CLEAR, "--layer-column", "red"], "--layer-column has no effect without --layer"),
        ([*CLEAR, "--coverage", "0.5"], "--coverage has no effect without --layer"),
        (
            [*CLEAR, "--layer", "0.9", "--coverage", "0.5", "--layer-model", "berns"],
            "--layer-model beside --coverage",
        ),
        (
            [*CLEAR, "--layer", "0.9", "--coverage", "50"],
            "argument --coverage: '50': expected a share from 0 to 1 (did",
        ),
        ([*CLEAR, "--specular", "some"], "argument --specular"),
        (
            [*CLEAR, "--angle", "1"],
            "not an angle of interfaced grooves that is modeled: expected at least 2 degrees",
        ),
        (
            ["--material", "lambertian", "--index", "1.5"],
            "--index belongs to --material specular or interfaced, not to",
        ),
        (
            ["--material", "specular", "--reflectance", "1"],
            "belongs to --material lambertian or interfaced, not to",
        ),
        (
            ["--material", "specular", "--index", "2", "--resample"],
            "--resample belongs to --material lambertian or",
        ),
        *(
            (
                ["--material", "lambertian", "--reflectance", "1", *option],
                f"{option[0]} belongs to --material interf",
            )
            for option in (
                ["--layer", "1"],
                ["--layer-model", "berns"],
                ["--layer-column", "a"],
                ["--coverage", "0"],
                ["--specular", "included"],
            )
        ),
    ],
)
def test_refuses(capsys: pytest.CaptureFixture[str], argv: list[str], said: str) -> None:
    angle = [] if "--angle" in argv else ["--angle", "75"]
    assert said in refusal(capsys, "predict", *argv, *angle, "--wavelengths", "500,505")


def test_predict_and_map_compute_the_same(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """On a flat surface, against its closed form [ClapperYule1953]."""
    flat = ["--angle", "180", *CLEAR, "--layer", "0.9", "--coverage", "0.25", "--tolerance", "1e-6"]
    said = ["predict", *flat, "--wavelengths", "500,600", "--output", str(tmp_path / "predicted.csv")]
    assert main(said) == 0
    m = Measurement.read(tmp_path / "predicted.csv")
    outside = 0.0917780  # diffuse reflectance of an interface of n = 1.5
    inside = 1 - (1 - outside) / 1.5**2
    once, twice = 1 - 0.25 + 0.25 * 0.9, 1 - 0.25 + 0.25 * 0.9**2
    below = (1 - inside) * 0.4 * once**2 / (1 - inside * 0.4 * twice)
    np.testing.assert_allclose(m.reflectance_factor, 0.04 + 0.96 * below, atol=2e-6)
    assert m.metadata["title"].endswith("interfaced, reflectance 0.4, index 1.5, layer 0.9, coverage 0.25")
    base = str(tmp_path / "map")
    assert main(["map", *flat, "--size", "3", "--output", base]) == 0
    with np.load(f"{base}.npz") as npz:
        np.testing.assert_allclose(npz["reflectance_factor"][1, 1], m.reflectance_factor[0, 0], atol=1e-6)
        assert "coverage 0.25" in str(npz["title"])


def test_varnished_sample_is_recovered(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ["--reflectance", FLAT, "--index", "1.5", "--angle-range", "40:120", "--tolerance", "1e-5"]
    assert main(["fit", CYAN, "--material", "interfaced", *options, "--output", str(tmp_path), "--json"]) == 0
    out, err = capsys.readouterr()
    answer = json.loads(out)
    angle = answer["parameters"]["angle"]
    assert abs(angle["value"] - 75) < 4 * angle["standard_error"] < 1.2
    assert 0.7 < answer["chi_square"] / answer["degrees_of_freedom"] < 1.3
    assert (answer["status"], answer["describes_data"], answer["warnings"], err) == ("converged", True, [], "")
    assert answer["scene"]["material"]["type"] == "InterfacedLambertian"
    assert answer["scene"]["material"]["layer"] is None
