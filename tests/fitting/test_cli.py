"""The command line: what it reads, prints and writes, and how it says no."""

import io
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Measurement
from fitting.cli import BAD_INPUT, BROKEN_PIPE, INTERRUPTED, NO_ANSWER, main, words
from fitting.priors import Normal
from fitting.readers import geometry
from vcavity_jax import geometries, materials

EXAMPLES = Path(__file__).parents[2] / "examples" / "data"
GOLD, ORANGE, FLAT = (str(EXAMPLES / name) for name in ("gold-v45.csv", "orange-v60.csv", "flat-orange.csv"))
METALS = str(EXAMPLES / "metals-nasa-tn-d-5353.csv")
MIRROR = ["--material", "specular", "--index", "Au-Johnson"]
MATTE = ["--material", "lambertian", "--reflectance"]


def refusal(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    """What a refused command says: one line on standard error, nothing else, status 2."""
    assert main(argv) == BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert err.endswith("\n")
    assert err.count("\n") == 1
    assert err.startswith("vcavity: ")
    assert "Traceback" not in err
    return err.removeprefix("vcavity: ").rstrip("\n")


def printed(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    assert main(argv) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return out


FRONTAL = vc.View(np.zeros(1), np.zeros(1))


# The command as a whole.


def test_help_needs_only_the_standard_library() -> None:
    code = (
        "import sys; from fitting.cli import main; status = main(['--help']);"
        "heavy = {'jax', 'numpy', 'matplotlib', 'equinox', 'yaml'} & set(sys.modules);"
        "sys.exit(f'{status} {heavy}' if status or heavy else 0)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith("usage: vcavity")


@pytest.mark.parametrize("command", ["fit", "predict", "materials"])
def test_each_command_has_help(capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert command in printed(capsys, "--help")
    assert printed(capsys, command, "--help").startswith(f"usage: vcavity {command}")


def test_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert printed(capsys, "--version") == f"vcavity {vc.__version__}\n"


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        ([], "COMMAND"),
        (["fat"], "invalid choice: 'fat'"),
        (["fit"], "MEASUREMENT, --material"),
        (["fit", GOLD, "--material", "wood"], "'wood'"),
        (["fit", GOLD, *MIRROR, "--col", "gold"], "unrecognized arguments: --col gold"),
        (["fit", "two\nlines.csv", *MIRROR], "two lines.csv: no such file"),
    ],
)
def test_bad_usage_is_told_in_one_line(capsys: pytest.CaptureFixture[str], argv: list[str], said: str) -> None:
    assert said in refusal(capsys, *argv)


def test_interrupt_leaves_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(materials, "names", interrupted)
    assert main(["materials"]) == INTERRUPTED == 130
    assert capsys.readouterr().err == "vcavity: interrupted\n"


def test_reader_that_leaves_is_no_error() -> None:
    code = "import sys; from fitting.cli import main; sys.exit(main(['materials']))"
    read, write = os.pipe()
    os.close(read)  # nobody will ever read
    try:
        run = subprocess.run(
            [sys.executable, "-c", code], stdout=write, stderr=subprocess.PIPE, text=True, check=False
        )
    finally:
        os.close(write)
    assert (run.returncode, run.stderr) == (BROKEN_PIPE, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_full_disk_behind_standard_output_is_told() -> None:
    code = "import sys; from fitting.cli import main; sys.exit(main(['materials']))"
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        run = subprocess.run(
            [sys.executable, "-c", code], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert run.stderr.splitlines()[0] == "vcavity: output: No space left on device"
    assert "Traceback" not in run.stderr
    assert run.returncode == BAD_INPUT


def test_terminal_without_unicode_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    assert main(["materials", "Al-Rakic"]) == 0
    stream.seek(0)
    assert "A. D. Raki?" in stream.read()


# The words that options take.


@pytest.mark.parametrize(
    ("text", "degrees"), [("45deg", 45), ("45", 45), ("45°", 45), ("1.5707963267948966rad", 90), ("180", 180)]
)
def test_angle_is_in_degrees_unless_it_says_radians(text: str, degrees: float) -> None:
    assert math.isclose(words.angle(text), math.radians(degrees), rel_tol=1e-15)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("400:700:100", [400, 500, 600, 700]),
        ("0.1:0.3:0.1", [0.1, 0.2, 0.3]),
        ("450,550,650.5", [450, 550, 650.5]),
        ("550", [550]),
        ("550:550:1", [550]),
    ],
)
def test_wavelengths(text: str, values: list[float]) -> None:
    assert words.grid(text) == values


BAD_WORDS = {
    "--angle": ["", "deg", "0", "-10", "181deg", "4rad", "x", "nan", "45grad"],
    "--roughness": ["-1", "0", "inf", "rough"],
    "--wavelengths": [
        "",
        "700:400:10",
        "400:700",
        "400:700:7",
        "400:700:0",
        "-5",
        "5,4",
        "5,5",
        "1:9e9:1e-3",
    ],
    "--polar": ["91", "0,0", "0,,1", "-0,0", "a"],
    "--azimuth": ["361", "90,90"],
    "--illumination": [
        *["sun", "directional", "directional:45", "directional:95,0", "directional:a,b", "directional:1,2,3"],
        *["diffuse:", "diffuse:0", "annular", "annular:-45", "annular:91", "annular:45,0"],
    ],
    "--geometry": ["45:0", "d/8", ""],
    "--geometry-azimuth": ["0,90", "361", "x"],
    "--trap": ["-1", "16", "nan", "wide"],
    "--tolerance": ["0", "-1e-8", "2", "small"],
}


@pytest.mark.parametrize(("option", "text"), [(name, text) for name in BAD_WORDS for text in BAD_WORDS[name]])
def test_bad_word_names_its_option(capsys: pytest.CaptureFixture[str], option: str, text: str) -> None:
    said = refusal(capsys, "predict", *MATTE, "0.5", "--angle", "45", "--wavelengths", "500", option, text)
    assert said.startswith(f"argument {option}: ")
    assert "expected" in said or "choose from" in said


BAD_FIT_WORDS = {
    "--fix": ["angle", "angle=", "angle=0", "gain=1", "roughness=-1", "roughness=0"],
    "--angle-range": ["10", "175:10", "0:90", "10:200", "a:b", "1:2:3"],
    "--roughness-range": ["0:1", "2:1"],
    "--wavelengths": ["800:390", "390"],
    "--uncertainty": ["0", "-0.1", "2", "nan"],
    "--reflectance-unit": ["permille"],
    "--free": ["thickness"],
    "--polarization": ["none"],
}


@pytest.mark.parametrize(
    ("option", "text"), [(name, text) for name in BAD_FIT_WORDS for text in BAD_FIT_WORDS[name]]
)
def test_bad_word_of_fit_names_its_option(capsys: pytest.CaptureFixture[str], option: str, text: str) -> None:
    said = refusal(capsys, "fit", GOLD, *MIRROR, option, text)
    assert said.startswith(f"argument {option}: ")
    assert "expected" in said or "choose from" in said


# Materials.


def test_materials_lists_every_table(capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, "materials").splitlines()
    assert [line.split()[0] for line in lines] == list(materials.names())
    gold = next(line for line in lines if line.startswith("Au-Johnson"))
    assert "187.9 to    1937 nm" in gold
    assert gold.endswith(materials.reference("Au-Johnson"))
    assert printed(capsys, "materials", "Au-Johnson").split() == gold.split()


@pytest.mark.parametrize("name", ["Au-Johnson", "PMMA-Sultanova"])
def test_table_reads_back_as_it_was(capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str) -> None:
    path = tmp_path / "index.csv"
    path.write_text(printed(capsys, "materials", name, "--wavelengths", "450:700:12.5"), encoding="utf-8")
    wavelengths = np.arange(450, 700.1, 12.5)
    expected = materials.refractive_index(name, wavelengths)
    np.testing.assert_array_equal(materials.read_index(path, wavelengths), expected)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["Au"], "did you mean Au-Johnson or Au-McPeak? 'vcavity materials' lists them all"),
        (["Au-Johnson", "--wavelengths", "5000"], "outside the table's range, 187.9 nm to 1937 nm"),
        (["--wavelengths", "500"], "needs the NAME"),
    ],
)
def test_materials_refuses(capsys: pytest.CaptureFixture[str], argv: list[str], said: str) -> None:
    assert said in refusal(capsys, "materials", *argv)


# Predictions.


def predicted(capsys: pytest.CaptureFixture[str], folder: Path, *argv: str) -> Measurement:
    path = folder / "predicted.csv"
    path.write_text(printed(capsys, "predict", *argv), encoding="utf-8")
    return Measurement.read(path)


def test_prediction_reads_back_equal(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ["--angle", "50deg", *MIRROR, "--wavelengths", "400:700:50"]
    m = predicted(capsys, tmp_path, *options, "--polar", "-30.1,0,60", "--azimuth", "0,90")
    wavelengths = np.arange(400.0, 701.0, 50.0)
    polar, azimuth = np.deg2rad([-30.1, 0, 60] * 2), np.deg2rad([0.0] * 3 + [90.0] * 3)
    scene = vc.Scene(
        vc.VGrooves(np.deg2rad(50.0)),
        vc.Specular(materials.refractive_index("Au-Johnson", wavelengths)),
        vc.Diffuse(),
        vc.View(polar, azimuth),
    )
    np.testing.assert_array_equal(m.wavelengths_nm, wavelengths)
    np.testing.assert_array_equal(m.polar, polar)
    np.testing.assert_array_equal(m.azimuth, azimuth)
    np.testing.assert_array_equal(m.reflectance_factor, vc.reflectance_factor(scene))
    assert isinstance(m.illumination, vc.Diffuse)
    assert m.metadata["title"] == "v-grooves, angle 50 deg, specular, index Au-Johnson"


def test_prediction_under_directional_light(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ["--angle", "90deg", *MATTE, "0.5", "--wavelengths", "500,600", "--tolerance", "1e-4"]
    m = predicted(capsys, tmp_path, *options, "--illumination", "directional:-45,10")
    light = vc.Directional(*np.deg2rad([-45.0, 10.0]))
    scene = vc.Scene(vc.VGrooves(np.pi / 2), vc.Lambertian(np.array([0.5, 0.5])), light, FRONTAL)
    np.testing.assert_array_equal(m.reflectance_factor, vc.reflectance_factor(scene, tolerance=1e-4))
    assert (m.illumination.polar, m.illumination.azimuth) == (light.polar, light.azimuth)


def test_prediction_of_random_grooves(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ["--surface", "beckmann", "--roughness", "0.3", "--tolerance", "1e-3", "--wavelengths", "500"]
    m = predicted(capsys, tmp_path, *options, *MATTE, "0.5")
    scene = vc.Scene(vc.BeckmannGrooves(0.3), vc.Lambertian(np.array([0.5])), vc.Diffuse(), FRONTAL)
    np.testing.assert_array_equal(m.reflectance_factor, vc.reflectance_factor(scene, tolerance=1e-3))


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> list[vc.Scene]:
    """The scenes whose reflectance factor is asked for; what is answered only has the right shape."""
    scenes = []

    def answer(scene: vc.Scene, tolerance: float) -> np.ndarray:
        scenes.append(scene)
        return np.full((*scene.view.shape, 2), 0.25)

    monkeypatch.setattr(vc, "reflectance_factor", answer)
    return scenes


def assert_same(one: Any, other: Any) -> None:
    """The same part of a scene, to the last bit."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for mine, yours in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(np.ravel(mine), np.ravel(yours))


PLAIN = [*MATTE, "0.5", "--angle", "60", "--wavelengths", "500,600"]


@pytest.mark.parametrize(
    ("name", "azimuth"),
    [(name, None) for name in geometry.GEOMETRIES] + [(name, 90.0) for name in geometry.TURNED],
)
def test_a_geometry_reads_back_as_the_same(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    made_up: list[vc.Scene],
    name: geometries.Geometry,
    azimuth: float | None,
) -> None:
    turned = [] if azimuth is None else ["--geometry-azimuth", str(azimuth)]
    m = predicted(capsys, tmp_path, *PLAIN, "--geometry", name, *turned)
    light, view = vc.cie_geometry(name, np.deg2rad(azimuth or 0.0))
    (scene,) = made_up
    for seen in (scene, m):
        assert_same(seen.illumination, light)
        assert_same(seen.view, view)
    assert m.reflectance_factor.tolist() == [[0.25, 0.25]]
    text = (tmp_path / "predicted.csv").read_text(encoding="utf-8")
    assert f"# geometry: {name}\n" in text
    assert "\nwavelength_nm,reflectance_factor\n500,0.25\n" in text
    assert " polar_deg" not in text


def test_a_trap_reads_back_as_it_was(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, made_up: list[vc.Scene]
) -> None:
    for option, expected in ([], 6.0), (["--trap", "5.1"], 5.1), (["--trap", "0"], 0.0):
        m = predicted(capsys, tmp_path, *PLAIN, "--geometry", "de:8", *option)
        assert f"# trap_half_angle_deg: {expected:g}\n" in (tmp_path / "predicted.csv").read_text(encoding="utf-8")
        assert m.illumination.half_angle == made_up[-1].illumination.half_angle == np.deg2rad(expected)


def test_a_ring_of_light_reads_back_as_the_same(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, made_up: list[vc.Scene]
) -> None:
    m = predicted(capsys, tmp_path, *PLAIN, "--illumination", "annular:45", "--polar", "0,30")
    for seen in (m, *made_up):
        assert_same(seen.illumination, vc.Annular(np.deg2rad(45.0)))
        np.testing.assert_array_equal(seen.view.polar, np.deg2rad([0.0, 30.0]))
    assert_same(predicted(capsys, tmp_path, *PLAIN, "--illumination", "diffuse").illumination, vc.Diffuse())


def test_gaussian_slopes_reach_the_model(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, made_up: list[vc.Scene]
) -> None:
    options = [*MATTE, "0.5", "--wavelengths", "500,600", "--surface", "gaussian", "--roughness", "0.3"]
    m = predicted(capsys, tmp_path, *options)
    assert_same(made_up[0].surface, vc.GaussianGrooves(0.3))
    assert m.metadata["title"] == "gaussian, roughness 0.3, lambertian, reflectance 0.5"


# A flat surface is cheap: its reflectance factor is that of the material.
PLANE = ["--angle", "180deg", "--wavelengths", "450,550"]


@pytest.mark.parametrize("text", ["0.2+3j", "0.2+3i", ".2+3.0e0j", "+0.2+3j", "index.csv"])
def test_index_as_number_or_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("index.csv").write_text("wavelength_nm,n,k\n400,0.2,3\n600,0.2,3\n", encoding="utf-8")
    m = predicted(capsys, tmp_path, *PLANE, "--material", "specular", "--index", text)
    index = 0.2 + 3j
    np.testing.assert_allclose(m.reflectance_factor, abs((index - 1) / (index + 1)) ** 2, atol=1e-8)


@pytest.mark.parametrize("polarization", ["full", "unpolarized", "separate"])
def test_polarization_reaches_the_model(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, polarization: str
) -> None:
    options = ["--angle", "50", "--wavelengths", "500", "--polar", "30", "--azimuth", "45"]
    options += ["--material", "specular", "--index", "1.5"]
    m = predicted(capsys, tmp_path, *options, "--polarization", polarization)
    view = vc.View(np.deg2rad([30.0]), np.deg2rad([45.0]))
    material = vc.Specular(np.array([1.5]), polarization)
    scene = vc.Scene(vc.VGrooves(np.deg2rad(50.0)), material, vc.Diffuse(), view)
    np.testing.assert_array_equal(m.reflectance_factor, vc.reflectance_factor(scene))


def test_flat_sample_is_used_as_measured_or_resampled(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    flat = tmp_path / "flat.csv"
    flat.write_text("wavelength_nm,reflectance\n400,0.1\n450,0.3\n500,0.2\n550,0.6\n", encoding="utf-8")
    m = predicted(capsys, tmp_path, *PLANE, *MATTE, str(flat))
    np.testing.assert_allclose(m.reflectance_factor, [[0.3, 0.6]], atol=1e-8)

    options = [*PLANE[:2], *MATTE, str(flat), "--wavelengths"]
    said = refusal(capsys, "predict", *options, "450,525")
    assert "no reflectance at 525 nm" in said
    assert "--resample" in said
    m = predicted(capsys, tmp_path, *options, "450,525", "--resample")
    np.testing.assert_allclose(m.reflectance_factor, [[0.3, 0.4]], atol=1e-8)
    said = refusal(capsys, "predict", *options, "450,560", "--resample")
    assert "560 nm is outside the spectrum's range, 400 nm to 550 nm" in said


def test_flat_sample_from_a_table(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ["--angle", "180", "--wavelengths", "330,354", *MATTE, METALS]
    m = predicted(capsys, tmp_path, *options, "--reflectance-column", "nickel")
    np.testing.assert_allclose(m.reflectance_factor, [[0.340, 0.355]], atol=1e-8)
    said = refusal(capsys, "predict", *options)
    assert "expected --reflectance-column with one of: aluminum, copper" in said


def test_prediction_is_written_whole_or_not_at_all(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "predicted.csv"
    argv = ["predict", *PLANE, *MATTE, "0.5", "--output", str(path)]
    assert printed(capsys, *argv) == ""
    good = path.read_text(encoding="utf-8")
    assert "reflectance 0.5" in good

    def full(source: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    argv[argv.index("0.5")] = "0.25"
    assert f"{path}: cannot write (No space left on device)" in refusal(capsys, *argv)
    assert path.read_text(encoding="utf-8") == good
    assert list(tmp_path.iterdir()) == [path]


SEEN = [*MATTE, "0.5", "--angle", "45", "--geometry"]


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        ([*MATTE, "0.5"], "--surface v-grooves needs --angle"),
        ([*MATTE, "0.5", "--surface", "beckmann"], "--surface beckmann needs --roughness"),
        ([*MATTE, "0.5", "--surface", "gaussian"], "--surface gaussian needs --roughness"),
        (
            [*MATTE, "0.5", "--angle", "45", "--roughness", "1"],
            "--roughness belongs to --surface beckmann or gaussian, not to v-grooves",
        ),
        (
            [*MATTE, "0.5", "--angle", "45", "--surface", "gaussian"],
            "--angle belongs to --surface v-grooves, not to gaussian",
        ),
        ([*SEEN, "d:8", "--polar", "8"], "--polar beside --geometry d:8, which sets light and view"),
        ([*SEEN, "d:0", "--azimuth", "0"], "--azimuth beside --geometry d:0"),
        ([*SEEN, "d:8", "--azimuth", "9"], "expected one of them (did you mean --geometry-azimuth?)"),
        ([*SEEN, "d:d", "--illumination", "diffuse"], "--illumination beside --geometry d:d"),
        (
            [*SEEN, "d:0", "--geometry-azimuth", "90"],
            "--geometry-azimuth has no effect in --geometry d:0: expected",
        ),
        (
            [*SEEN, "d:8", "--trap", "5"],
            "--trap has no effect in --geometry d:8: expected --geometry de:8 with it",
        ),
        ([*SEEN[:-1], "--trap", "5"], "--trap has no effect without --geometry"),
        ([*SEEN[:-1], "--geometry-azimuth", "5"], "has no effect without --geometry: expected --geometry d:8 or"),
        (["--material", "lambertian", "--angle", "45"], "needs --reflectance"),
        (["--material", "specular", "--angle", "45"], "needs --index"),
        ([*MATTE, "0.5", "--angle", "45", "--index", "1.5"], "--index belongs to --material specular"),
        ([*MIRROR, "--angle", "45", "--reflectance", "1"], "--reflectance belongs to --material lambertian"),
        ([*MATTE, "50", "--angle", "45"], "--reflectance 50: expected a fraction from 0 to 1: did you pass"),
        ([*MATTE, "gone.csv", "--angle", "45"], "gone.csv: no such file"),
        ([*MATTE, str(EXAMPLES), "--angle", "45"], "is a directory"),
        ([*MIRROR[:3], "Au-Jonson", "--angle", "45"], "did you mean Au-Johnson?"),
        ([*MIRROR[:3], "gone.yml", "--angle", "45"], "gone.yml: no such file"),
        ([*MIRROR[:3], "1.5-2j", "--angle", "45"], "--index 1.5-2j: expected n + ik with n > 0 and k ≥ 0"),
        ([*MIRROR[:3], "0", "--angle", "45"], "--index 0: expected n + ik"),
        ([*MIRROR, "--angle", "45", "--illumination", "directional:0,0"], "delta function"),
        ([*MATTE, "0.5", "--angle", "45", "--output", str(EXAMPLES)], "is a directory"),
        ([*MATTE, "0.5", "--angle", "45", "--output", "/gone/a.csv"], "/gone/a.csv: cannot write"),
    ],
)
def test_predict_refuses(capsys: pytest.CaptureFixture[str], argv: list[str], said: str) -> None:
    assert said in refusal(capsys, "predict", *argv, "--wavelengths", "500")


def test_predict_refuses_wavelengths_beyond_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    said = refusal(capsys, "predict", "--angle", "45", *MIRROR, "--wavelengths", "500,2000")
    assert said.startswith("Au-Johnson: wavelength 2000 nm is outside the table's range, 187.9 nm to 1937 nm")


# Fits: what the options mean, with a stand-in for the fit itself.


class StandIn:
    """Takes the place of `fit`: keeps what it is asked, answers what the test wants."""

    def __init__(self, status: str = "converged", identifiable: bool = True) -> None:
        self.status, self.identifiable = status, identifiable
        self.describes_data: bool | None = True
        self.message = "why,\nand what to do"

    def __call__(self, scene: vc.Scene, measurement: Measurement, parameters: list, **options: Any) -> Any:
        self.scene, self.measurement, self.options = scene, measurement, options
        self.bounds = {one.name: (one.lower, one.upper) for one in parameters}
        self.priors = {one.name: one.prior for one in parameters}
        return self

    def summary(self) -> str:
        return "angle 45.00 ± 0.02 deg"

    def to_dict(self) -> dict[str, Any]:
        return {"status": "converged"}

    def plot(self, path: Path) -> None:
        path.write_bytes(b"picture")


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> StandIn:
    stand_in = StandIn()
    monkeypatch.setattr("fitting.cli.fit.fit", stand_in)
    return stand_in


def fit(capsys: pytest.CaptureFixture[str], folder: Path, *argv: str) -> str:
    return printed(capsys, "fit", *argv, "--output", str(folder))


def test_fit_of_a_mirror(capsys: pytest.CaptureFixture[str], tmp_path: Path, stand_in: StandIn) -> None:
    fit(capsys, tmp_path, GOLD, *MIRROR)
    scene, m = stand_in.scene, Measurement.read(GOLD)
    assert isinstance(scene.surface, vc.VGrooves)
    np.testing.assert_array_equal(scene.material.index, materials.refractive_index("Au-Johnson", m.wavelengths_nm))
    assert scene.material.polarization == "full"
    assert isinstance(scene.illumination, vc.Diffuse)
    np.testing.assert_array_equal(scene.view.polar, m.polar)
    np.testing.assert_array_equal(scene.view.azimuth, m.azimuth)
    np.testing.assert_array_equal(stand_in.measurement.reflectance_factor, m.reflectance_factor)
    assert stand_in.bounds == {"angle": (math.radians(5), math.radians(180))}
    assert stand_in.options == {"standard_uncertainty": None, "tolerance": 1e-8}


def test_fit_takes_light_and_view_from_the_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, stand_in: StandIn
) -> None:
    source = tmp_path / "sphere.csv"
    for head, expected in (
        ("# geometry: d:d", vc.cie_geometry("d:d")),
        ("# geometry: 8:d\n# geometry_azimuth_deg: 90", vc.cie_geometry("8:d", np.pi / 2)),
        ("# geometry: 45a:0", vc.cie_geometry("45a:0")),
        ("# illumination: annular, polar_deg=60\n# polar_deg: 20", (vc.Annular(np.pi / 3), vc.View(np.pi / 9))),
    ):
        source.write_text(f"{head}\nwavelength_nm,reflectance\n500,0.3\n600,0.4\n", encoding="utf-8")
        fit(capsys, tmp_path / "out", str(source), *MATTE, "0.5")
        assert_same(stand_in.scene.illumination, expected[0])
        assert_same(stand_in.scene.view, expected[1])


def test_fit_of_a_matte_surface(capsys: pytest.CaptureFixture[str], tmp_path: Path, stand_in: StandIn) -> None:
    fit(capsys, tmp_path, ORANGE, *MATTE, FLAT)
    expected = Measurement.read(FLAT).reflectance_factor[0]
    np.testing.assert_array_equal(stand_in.scene.material.reflectance, expected)
    fit(capsys, tmp_path, ORANGE, *MATTE, FLAT, "--wavelengths", "450:600")
    np.testing.assert_array_equal(stand_in.scene.material.reflectance, expected[5:21])
    np.testing.assert_array_equal(stand_in.measurement.wavelengths_nm, np.arange(450, 601, 10))


ROUGH, GAUSSIAN = ["--surface", "beckmann"], ["--surface", "gaussian"]


@pytest.mark.parametrize(
    ("argv", "bounds"),
    [
        (["--free", "angle", "--free", "gain"], {"angle": (5, 180), "gain": None}),
        (["--free", "offset", "--free", "angle", "--free", "offset"], {"offset": None, "angle": (5, 180)}),
        (["--angle-range", "10:175"], {"angle": (10, 175)}),
        (ROUGH, {"roughness": (0.01, 3)}),
        ([*ROUGH, "--roughness-range", "0.1:1", "--free", "roughness"], {"roughness": (0.1, 1)}),
        (GAUSSIAN, {"roughness": (0.01, 3)}),
        ([*GAUSSIAN, "--fix", "roughness=0.3", "--free", "gain"], {"gain": None}),
        (["--fix", "angle=45deg", "--free", "gain"], {"gain": None}),
        (
            [*ROUGH, "--fix", "roughness=0.3", "--free", "gain", "--free", "offset"],
            {"gain": None, "offset": None},
        ),
    ],
)
def test_free_and_fixed_parameters(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    stand_in: StandIn,
    argv: list[str],
    bounds: dict[str, Any],
) -> None:
    fit(capsys, tmp_path, GOLD, *MIRROR, *argv)
    assert list(stand_in.bounds) == list(bounds)
    for name, limits in bounds.items():
        if limits is not None:
            expected = np.deg2rad(limits) if name == "angle" else limits
            np.testing.assert_allclose(stand_in.bounds[name], expected, rtol=1e-15)
    kind = vc.BeckmannGrooves if "beckmann" in argv else vc.GaussianGrooves if "gaussian" in argv else vc.VGrooves
    assert type(stand_in.scene.surface) is kind
    if "angle=45deg" in argv:
        assert stand_in.scene.surface.angle == math.radians(45)
    if "roughness=0.3" in argv:
        assert stand_in.scene.surface.roughness == 0.3


def test_priors_of_gain_and_offset(capsys: pytest.CaptureFixture[str], tmp_path: Path, stand_in: StandIn) -> None:
    options = ["--free", "angle", "--free", "gain", "--free", "offset"]
    fit(capsys, tmp_path, GOLD, *MIRROR, *options)
    assert stand_in.priors == {"angle": None, "gain": Normal(1.0, 0.01), "offset": Normal(0.0, 0.002)}
    fit(capsys, tmp_path, GOLD, *MIRROR, *options, "--no-priors")
    assert stand_in.priors == {"angle": None, "gain": None, "offset": None}


def test_options_of_the_measurement_and_the_model(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, stand_in: StandIn
) -> None:
    options = ["--polarization", "separate", "--tolerance", "1e-5", "--uncertainty", "0.02"]
    options += ["--column", "nickel", "--wavelengths", "390:800", "--reflectance-unit", "fraction"]
    fit(capsys, tmp_path, METALS, "--material", "specular", "--index", "Ni-Johnson", *options)
    expected = Measurement.read(METALS, column="nickel").select(wavelengths_nm=(390.0, 800.0))
    np.testing.assert_array_equal(stand_in.measurement.reflectance_factor, expected.reflectance_factor)
    assert stand_in.scene.material.polarization == "separate"
    assert stand_in.options == {"standard_uncertainty": 0.02, "tolerance": 1e-5}

    percent = tmp_path / "percent.csv"
    percent.write_text("wavelength_nm,reflectance\n500,1.5\n600,2\n", encoding="utf-8")
    fit(capsys, tmp_path, str(percent), *MATTE, "0.5", "--reflectance-unit", "percent")
    np.testing.assert_allclose(stand_in.measurement.reflectance_factor, [[0.015, 0.02]])


def test_output_stands_beside_the_measurement(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, stand_in: StandIn
) -> None:
    source = tmp_path / "my sample.v2.csv"
    source.write_bytes(Path(GOLD).read_bytes())
    out = printed(capsys, "fit", str(source), *MIRROR)
    folder = tmp_path / "my sample.v2-fit"
    assert out.splitlines() == [
        "angle 45.00 ± 0.02 deg",
        f"wrote {folder / 'fit.json'}",
        f"wrote {folder / 'fit.png'}",
    ]
    assert (folder / "fit.png").read_bytes() == b"picture"
    printed(capsys, "fit", str(source), *MIRROR)  # again, into the same folder


def test_json_is_printed_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path, stand_in: StandIn) -> None:
    out = fit(capsys, tmp_path / "a" / "b", GOLD, *MIRROR, "--json")
    assert out == (tmp_path / "a" / "b" / "fit.json").read_text(encoding="utf-8")
    assert json.loads(out) == {"status": "converged"}


@pytest.mark.parametrize(
    ("status", "identifiable"),
    [("not converged", True), ("at bound", True), ("not identifiable", False), ("converged", False)],
)
@pytest.mark.parametrize("option", [[], ["--json"]])
def test_fit_without_trustworthy_answer_says_why(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    stand_in: StandIn,
    status: str,
    identifiable: bool,
    option: list[str],
) -> None:
    stand_in.status, stand_in.identifiable = status, identifiable
    assert main(["fit", GOLD, *MIRROR, "--output", str(tmp_path), *option]) == NO_ANSWER == 1
    out, err = capsys.readouterr()
    assert out.startswith("{" if option else "angle")
    assert err == f"vcavity: {status}: why, and what to do\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.json", "fit.png"]


@pytest.mark.parametrize(("describes", "said"), [(False, "vcavity: converged: why, and what to do\n"), (None, "")])
def test_poor_fit_is_told_and_keeps_its_status(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, stand_in: StandIn, describes: bool | None, said: str
) -> None:
    stand_in.describes_data = describes
    assert main(["fit", GOLD, *MIRROR, "--output", str(tmp_path)]) == 0
    assert capsys.readouterr().err == said


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["gone.csv", *MIRROR], "gone.csv: no such file"),
        ([str(EXAMPLES), *MIRROR], "is a directory; expected a measurement file"),
        ([METALS, *MIRROR], "expected --column with one of: aluminum"),
        ([GOLD, *MIRROR, "--column", "gold"], "no column 'gold'"),
        ([GOLD, *MIRROR, "--reflectance-unit", "percent"], "expected --reflectance-unit fraction"),
        ([GOLD, *MIRROR, "--wavelengths", "800:900"], f"{GOLD}: --wavelengths: no wavelength lies within"),
        ([METALS, *MIRROR, "--column", "gold"], "187.9 nm to 1937 nm: choose others with --wavelengths"),
        ([GOLD, *MATTE, FLAT, "--index", "1.5"], "--index belongs to --material specular"),
        ([GOLD, *MIRROR, "--free", "gain"], "angle is neither free nor fixed"),
        ([GOLD, *MIRROR, "--free", "roughness"], "--free roughness belongs to --surface beckmann"),
        ([GOLD, *MIRROR, *ROUGH, "--free", "angle"], "--free angle belongs to --surface v-grooves"),
        ([GOLD, *MIRROR, "--fix", "roughness=1"], "--fix roughness belongs to --surface beckmann"),
        ([GOLD, *MIRROR, "--fix", "angle=45", "--fix", "angle=46"], "--fix angle is given twice"),
        ([GOLD, *MIRROR, "--fix", "angle=45"], "--fix angle leaves nothing to fit"),
        ([GOLD, *MIRROR, "--fix", "angle=45", "--free", "angle"], "angle is in --free and in --fix"),
        (
            [GOLD, *MIRROR, "--fix", "angle=45", "--free", "gain", "--angle-range", "1:9"],
            "--angle-range has no effect",
        ),
        ([GOLD, *MIRROR, "--no-priors"], "--no-priors has no effect"),
        ([GOLD, *MIRROR, "--roughness-range", "1:2"], "--roughness-range belongs to --surface beckmann"),
        ([GOLD, *MIRROR, *ROUGH, "--angle-range", "1:2"], "--angle-range belongs to --surface v-grooves"),
    ],
)
def test_fit_refuses(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, stand_in: StandIn, argv: list[str], said: str
) -> None:
    folder = tmp_path / "out"
    assert said in refusal(capsys, "fit", *argv, "--output", str(folder))
    assert not folder.exists()
    assert not hasattr(stand_in, "scene")


def test_unwritable_output_is_refused_before_the_fit(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, stand_in: StandIn
) -> None:
    file = tmp_path / "file"
    file.touch()
    for folder in (file, file / "below"):
        said = refusal(capsys, "fit", GOLD, *MIRROR, "--output", str(folder))
        assert said == f"{file}: is a file; expected a folder for the output"
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "fit.json").mkdir()  # what only the writing itself can find out
    said = refusal(capsys, "fit", GOLD, *MIRROR, "--output", str(tmp_path / "real"))
    assert "fit.json" in said
    assert "irectory" in said


# Fits in earnest.


def strict(text: str) -> Any:
    """JSON without the constants that JSON does not have."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} in the JSON")

    return json.loads(text, parse_constant=refuse)


def test_fit_finds_what_was_predicted(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    source, folder = tmp_path / "matte.csv", tmp_path / "matte-fit"
    matte = [*MATTE, "0.5", "--tolerance", "1e-6"]
    printed(capsys, "predict", "--angle", "60", *matte, "--wavelengths", "500,600", "--output", str(source))

    out = printed(capsys, "fit", str(source), *matte, "--uncertainty", "0.005", "--json")

    answer = strict(out)
    assert out == (folder / "fit.json").read_text(encoding="utf-8")
    assert (folder / "fit.png").read_bytes().startswith(b"\x89PNG")
    assert answer["status"] == "converged"
    assert answer["identifiable"] is True
    angle = answer["parameters"]["angle"]
    assert angle["unit"] == "deg"
    assert angle["value"] == pytest.approx(60, abs=1e-3)
    ((low, high),) = angle["interval_95"]
    assert low < 60 < high
    # The profile of a smooth model is close to a parabola this near its minimum.
    assert high - low == pytest.approx(2 * 1.96 * angle["standard_error"], rel=0.05)
    assert (angle["at_bound"], angle["at_kink"]) == (False, False)
    assert answer["degrees_of_freedom"] == 1
    assert answer["chi_square"] == pytest.approx(0, abs=1e-6)
    assert len(answer["minima"]) == 1
    assert answer["scene"]["surface"]["angle_deg"] == angle["value"]
    assert answer["version"] == vc.__version__


def test_fit_of_the_gain_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    source = tmp_path / "matte.csv"
    source.write_text("wavelength_nm,reflectance\n500,0.55\n600,0.33\n", encoding="utf-8")
    options = ["--fix", "angle=180", "--free", "gain", "--no-priors", "--uncertainty", "0.01", "--json"]
    flat = tmp_path / "flat.csv"
    flat.write_text("wavelength_nm,reflectance\n500,0.5\n600,0.3\n", encoding="utf-8")
    answer = strict(printed(capsys, "fit", str(source), *MATTE, str(flat), *options))
    assert list(answer["parameters"]) == ["gain"]
    assert answer["parameters"]["gain"]["value"] == pytest.approx(1.1, abs=1e-6)
    assert answer["scene"]["surface"]["angle_deg"] == 180
    assert (tmp_path / "matte-fit" / "fit.png").exists()


def test_blind_fit_has_status_1(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    source = tmp_path / "mirror.csv"
    mirror = [*MIRROR, "--tolerance", "1e-6"]
    printed(capsys, "predict", "--angle", "160", *mirror, "--wavelengths", "500,600", "--output", str(source))
    assert main(["fit", str(source), *mirror, "--uncertainty", "0.005"]) == NO_ANSWER
    out, err = capsys.readouterr()
    assert err.startswith("vcavity: not identifiable: ")
    assert err.count("\n") == 1
    assert "angle" in out.splitlines()[1]
    answer = strict((tmp_path / "mirror-fit" / "fit.json").read_text(encoding="utf-8"))
    assert (answer["status"], answer["identifiable"]) == ("not identifiable", False)
    assert answer["parameters"]["angle"]["standard_error"] is None
