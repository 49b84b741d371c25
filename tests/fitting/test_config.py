"""What a fit may vary on the command line, and the config file: what they mean, and how they say no."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Measurement, free, spectra
from fitting.cli import BAD_INPUT, config, main
from fitting.priors import LogNormal, Normal, TruncatedNormal, Uniform
from vcavity_jax import materials

EXAMPLES = Path(__file__).parents[2] / "examples" / "data"
GOLD, ORANGE, FLAT = (str(EXAMPLES / name) for name in ("gold-v45.csv", "orange-v60.csv", "flat-orange.csv"))
NM = np.array([450.0, 500.0, 550.0, 600.0, 650.0])

ONE = '[[measurement]]\nfile = "a.csv"\n'
TWO = '[[measurement]]\nfile = "a.csv"\n[[measurement]]\nfile = "b.csv"\n'
MATTE = '[scene]\nmaterial = "lambertian"\nreflectance = 0.5\n'
MIRROR = '[scene]\nmaterial = "specular"\nindex = "Au-Johnson"\n'
ROUGH = '[scene]\nmaterial = "lambertian"\nreflectance = 0.5\nsurface = "beckmann"\n'
INKED = '[scene]\nmaterial = "interfaced"\nreflectance = 0.9\nindex = 1.5\nlayer = 0.5\ncoverage = 0.4\n'


class Asked(Exception):
    """The fit that would be made."""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with two measurements and a flat spectrum."""
    monkeypatch.chdir(tmp_path)
    for name, value in (("a.csv", 0.3), ("b.csv", 0.4)):
        rows = [f"{nm:g},{value + nm / 1e4:g}" for nm in NM]
        Path(name).write_text("wavelength_nm,reflectance\n" + "\n".join(rows) + "\n", encoding="utf-8")
    rows = [f"{nm:g},{nm / 1000:g}" for nm in NM]
    Path("flat.csv").write_text("wavelength_nm,reflectance\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return tmp_path


@pytest.fixture
def no_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    def caught(scene: Any, measurement: Any, parameters: list, **options: Any) -> None:
        raise Asked(scene, measurement, parameters, options)

    monkeypatch.setattr("fitting.cli.fit.fit", caught)


def asked(*argv: str) -> tuple[Any, Any, list, dict]:
    """Scene, measurement, free parameters and options that a command hands to the fit."""
    with pytest.raises(Asked) as caught:
        main(["fit", *argv])
    return caught.value.args


def configured(text: str, *argv: str) -> tuple[Any, Any, list, dict]:
    Path("fit.toml").write_text(text, encoding="utf-8")
    return asked("--config", "fit.toml", *argv)


def refusal(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    assert main(["fit", *argv]) == BAD_INPUT
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert not list(Path().glob("*-fit"))
    return err.removeprefix("vcavity: ").rstrip("\n")


def refused(capsys: pytest.CaptureFixture[str], text: str, *argv: str) -> str:
    Path("fit.toml").write_text(text, encoding="utf-8")
    return refusal(capsys, "--config", "fit.toml", *argv)


def nowhere(scene: Any) -> Any:
    return scene


def assert_parameters(found: list, expected: list, scene: Any) -> None:
    """The same parameters, which pick the same leaves of a scene."""
    assert len(found) == len(expected)
    for mine, yours in zip(found, expected, strict=True):
        if mine.where is not None:
            assert mine.where(scene) is yours.where(scene)
        assert dataclasses.replace(mine, where=nowhere) == dataclasses.replace(yours, where=nowhere)


def assert_same(one: Any, other: Any) -> None:
    """The same part of a scene, to the last bit."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for mine, yours in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert mine.dtype == yours.dtype
        assert mine.shape == yours.shape
        np.testing.assert_array_equal(mine, yours)


# Parameters on the command line.

LAMBERTIAN = ["a.csv", "--material", "lambertian"]
CLEAR = ["a.csv", "--material", "interfaced", "--reflectance", "0.9", "--index", "1.5"]
DOTS = [*CLEAR, "--layer", "0.5", "--coverage", "0.4"]
GRAY = vc.Lambertian(np.full(5, 0.5))


@pytest.mark.parametrize(
    ("argv", "parameters", "material"),
    [
        ([*LAMBERTIAN, "--free", "angle", "--free", "reflectance"], [free.angle(), free.reflectance()], GRAY),
        ([*LAMBERTIAN, "--free", "reflectance", "--fix", "angle=60"], [free.reflectance()], GRAY),
        (
            [
                *LAMBERTIAN,
                "--reflectance",
                "flat.csv",
                "--free",
                "reflectance",
                "--smooth",
                "50",
                "--fix",
                "angle=9",
            ],
            [free.reflectance(smooth_nm=50.0)],
            vc.Lambertian(NM / 1000),
        ),
        (
            [*DOTS, "--free", "angle", "--free", "coverage", "--free", "transmittance"],
            [free.angle(lower_deg=10), free.coverage(), free.transmittance()],
            vc.InterfacedLambertian(np.full(5, 0.9), 1.5, vc.Halftone(0.4, np.float64(0.5))),
        ),
        (
            [*CLEAR, "--free", "angle", "--free", "index", "--index-range", "1.4:1.6"],
            [free.angle(lower_deg=10), free.index(1.4, 1.6)],
            vc.InterfacedLambertian(np.full(5, 0.9), 1.5),
        ),
        (
            ["a.csv", "--material", "specular", "--free", "angle", "--free", "index"],
            [free.angle(), free.index()],
            vc.Specular(1.5),
        ),
        (
            ["a.csv", "--material", "specular", "--index", "1.7", "--free", "angle", "--free", "index"],
            [free.angle(), free.index()],
            vc.Specular(1.7),
        ),
        (
            [*LAMBERTIAN, "--reflectance", "0.5"]
            + [word for name in ("angle", "tilt", "stray_light", "wavelength_shift") for word in ("--free", name)],
            [free.angle(), *free.tilt(), free.stray_light(), free.wavelength_shift()],
            GRAY,
        ),
        (
            [*LAMBERTIAN, "--reflectance", "0.5", "--no-priors"]
            + [word for name in ("angle", "tilt", "wavelength_shift", "gain") for word in ("--free", name)],
            [free.angle(), *free.tilt(None), free.wavelength_shift(prior_nm=None), free.gain(None)],
            GRAY,
        ),
    ],
)
def test_options_free_parameters(no_fit: None, argv: list[str], parameters: list, material: Any) -> None:
    scene, _, found, _ = asked(*argv)
    assert_parameters(found, parameters, scene)
    assert_same(scene.material, material)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        ([*LAMBERTIAN], "--material lambertian needs --reflectance"),
        (
            [*LAMBERTIAN, "--free", "reflectance"],
            "angle is neither free nor fixed: expected --free angle or --fix",
        ),
        (
            [*LAMBERTIAN, "--free", "angle", "--free", "reflectance", "--reflectance-column", "x"],
            "--reflectance-column has no effect without --reflectance",
        ),
        (
            ["a.csv", "--material", "specular", "--index", "1.5", "--free", "reflectance"],
            "--free reflectance belongs to --material lambertian or interfaced, not to specular",
        ),
        ([*LAMBERTIAN, "--free", "index"], "--free index belongs to --material specular or interfaced, not to"),
        ([*LAMBERTIAN, "--free", "coverage"], "--free coverage belongs to --material interfaced, not to"),
        ([*LAMBERTIAN, "--free", "transmittance"], "--free transmittance belongs to --material interfaced"),
        (
            [*CLEAR, "--free", "transmittance"],
            "--free transmittance has no effect without --layer: expected --layer",
        ),
        (
            [*CLEAR, "--free", "coverage", "--layer", "0.5"],
            "--free coverage has no effect without --coverage: expected --layer with --coverage beside it",
        ),
        (
            [*CLEAR, "--smooth", "50"],
            "--smooth has no effect: expected --free reflectance or transmittance with it",
        ),
        (
            [*CLEAR, "--free", "reflectance", "--smooth", "-5"],
            "argument --smooth: '-5': expected a number of nano",
        ),
        ([*CLEAR, "--index-range", "1:2"], "--index-range has no effect: index is not free"),
        ([*LAMBERTIAN, "--index-range", "1:2"], "--index-range belongs to --material specular or interfaced"),
        (
            ["a.csv", "--material", "specular", "--index", "Au-Johnson", "--free", "angle", "--free", "index"],
            "--index Au-Johnson: expected a number such as 1.5, or none: one real index for all wavelengths is",
        ),
        ([*LAMBERTIAN, "--no-priors"], "--no-priors has no effect: expected --free gain or offset or tilt or"),
        (["a.csv"], "required: --material, or --config"),
    ],
)
def test_options_refuse(no_fit: None, capsys: pytest.CaptureFixture[str], argv: list[str], said: str) -> None:
    assert said in refusal(capsys, *argv)


# Parameters in a config file.


def parameters(table: str) -> str:
    return f"[parameters.{table}\n".replace(" ", "]\n", 1) if " " in table else f"[parameters.{table}]\n"


@pytest.mark.parametrize(
    ("scene", "tables", "expected"),
    [
        (MATTE, [], [free.angle()]),
        (ROUGH, [], [free.roughness()]),
        (INKED, [], [free.angle(lower_deg=10)]),
        (MATTE, ["angle lower_deg = 20"], [free.angle(20)]),
        (INKED, ["angle upper_deg = 100"], [free.angle(10, 100)]),
        (ROUGH, ["roughness lower = 0.1\nupper = 1"], [free.roughness(0.1, 1)]),
        (MATTE, ["angle", "reflectance"], [free.angle(), free.reflectance()]),
        (
            MATTE,
            ["angle", "reflectance prior = 0.03\nupper = 0.9"],
            [free.angle(), free.reflectance(prior=0.03, upper=0.9)],
        ),
        (MATTE, ["angle", "reflectance smooth_nm = 50"], [free.angle(), free.reflectance(smooth_nm=50.0)]),
        (
            INKED,
            ["angle", "transmittance lower = 0.1", "coverage upper = 0.8"],
            [free.angle(lower_deg=10), free.transmittance(lower=0.1), free.coverage(upper=0.8)],
        ),
        (
            MATTE,
            ["angle", "gain", 'offset prior = "none"'],
            [free.angle(), free.gain(), free.offset(None)],
        ),
        (MATTE, ["angle", "tilt limit_deg = 2"], [free.angle(), *free.tilt(limit_deg=2)]),
        (
            MATTE,
            ["angle", 'tilt prior = { kind = "normal", mean = 0, standard_deviation = 0.3 }'],
            [free.angle(), *free.tilt((0.0, 0.3))],
        ),
        (MATTE, ["angle", "stray_light upper = 0.1"], [free.angle(), free.stray_light(0.1)]),
        (
            MATTE,
            ["angle", 'wavelength_shift limit_nm = 2\nprior = "none"'],
            [free.angle(), free.wavelength_shift(2, None)],
        ),
    ],
)
def test_each_table_frees_a_parameter(no_fit: None, scene: str, tables: list[str], expected: list) -> None:
    seen, _, found, _ = configured(ONE + scene + "".join(map(parameters, tables)))
    assert_parameters(found, expected, seen)


@pytest.mark.parametrize(
    ("text", "prior"),
    [
        ('{ kind = "normal", mean = 45, standard_deviation = 2 }', Normal(45.0, 2.0)),
        ('{ kind = "log-normal", median = 45, spread = 0.1 }', LogNormal(45.0, 0.1)),
        ('{ kind = "uniform", lower = 40, upper = 50 }', Uniform(40.0, 50.0)),
        (
            '{ kind = "truncated", mean = 45, standard_deviation = 2, upper = 50 }',
            TruncatedNormal(45.0, 2.0, upper=50.0),
        ),
        ('"none"', None),
    ],
)
def test_kinds_of_priors(no_fit: None, text: str, prior: Any) -> None:
    scene, _, found, _ = configured(ONE + MATTE + parameters(f"angle prior = {text}"))
    assert_parameters(found, [free.angle(prior=prior)], scene)


CAUCHY = 'form = "cauchy"\na = [1.4, 1.6]\nb_um2 = 0.004'
SELLMEIER = 'form = "sellmeier"\nb = [[0.5, 1.5], 0.4]\nc_um2 = [[0.001, 0.02], 0.01]'
DRUDE = (
    'form = "drude-lorentz"\nepsilon_infinity = 6\nplasma_ev = [5, 10]\noscillators = [[[0.1, 2], 3.0, [0.1, 1]]]'
)


@pytest.mark.parametrize(
    ("given", "table", "expected", "index"),
    [
        ("1.7", "lower = 1.3", free.index(1.3), np.float64(1.7)),
        ("1.7", 'form = "constant"', free.index(), np.float64(1.7)),
        ("1.7", 'form = "per-wavelength"\nupper = 2.5', free.index_spectrum(upper=(2.5,)), np.full(5, 1.7)),
        (
            '"PMMA-Sultanova"',
            f"{CAUCHY}\nc_um4 = [0, 0.01]",
            free.index_spectrum(spectra.Cauchy((1.4, 1.6), 0.004, (0.0, 0.01))),
            materials.refractive_index("PMMA-Sultanova", NM).real,
        ),
        (None, CAUCHY, free.index_spectrum(spectra.Cauchy((1.4, 1.6), 0.004)), np.full(5, 1.5)),
        (
            "1.5",
            SELLMEIER,
            free.index_spectrum(spectra.Sellmeier([(0.5, 1.5), 0.4], [(0.001, 0.02), 0.01])),
            np.full(5, 1.5),
        ),
        (
            '"Au-Johnson"',
            'form = "n-and-k"\nprior = 0.03\nlower = [0.1, 0.2]',
            free.index_spectrum(complex_valued=True, prior=0.03, lower=(0.1, 0.2)),
            materials.refractive_index("Au-Johnson", NM),
        ),
        (
            "1.5",
            DRUDE,
            free.index_spectrum(
                spectra.DrudeLorentz(6.0, (5.0, 10.0), oscillators=[((0.1, 2.0), 3.0, (0.1, 1.0))])
            ),
            np.full(5, 1.5 + 0j),
        ),
    ],
)
def test_forms_of_the_index(no_fit: None, given: str | None, table: str, expected: Any, index: Any) -> None:
    scene = '[scene]\nmaterial = "specular"\n' + (f"index = {given}\n" if given else "")
    seen, _, found, _ = configured(ONE + scene + "[parameters.angle]\n" + parameters(f"index {table}"))
    assert_parameters(found, [free.angle(), expected], seen)
    assert_same(seen.material, vc.Specular(index))
    hash(found[1])  # compiled programs are found again by it


def test_values_spread_over_measurements(no_fit: None) -> None:
    tables = ["angle", 'gain measurements = "separate"', 'tilt measurements = ["b"]']
    tables += ['stray_light measurements = "shared"']
    scenes, measurements, found, _ = configured(TWO + MATTE + "".join(map(parameters, tables)))
    assert list(scenes) == list(measurements) == ["a", "b"]
    tilts = [p.only("b") for p in free.tilt()]
    expected = [free.angle(), free.gain().separate(), *tilts, free.stray_light()]
    assert_parameters(found, expected, scenes["a"])


@pytest.mark.parametrize("spread", ['"separate"', '["a"]', '"shared"'])
def test_of_one_measurement_there_is_nothing_to_spread(no_fit: None, spread: str) -> None:
    given = configured(f"{ONE}{MATTE}[parameters.angle]\n[parameters.gain]\nmeasurements = {spread}\n")[2]
    assert [(p.name, p.among) for p in given] == [("angle", "shared"), ("gain", "shared")]


def test_a_parameter_may_have_a_table_for_each_measurement(no_fit: None) -> None:
    tables = (
        '[[parameters.gain]]\nmeasurements = ["a"]\n[[parameters.gain]]\nmeasurements = ["b"]\nprior = "none"\n'
    )
    scenes, _, found, _ = configured(TWO + MATTE + "[parameters.angle]\n" + tables)
    expected = [free.angle(), free.gain().only("a"), free.gain(None).only("b")]
    assert_parameters(found, expected, scenes["a"])


# The scene and the measurements of a config file.


def test_a_scene_is_the_same_in_a_config_and_in_options(no_fit: None) -> None:
    scene = '[scene]\nmaterial = "interfaced"\nreflectance = "flat.csv"\nindex = "PMMA-Sultanova"\n'
    scene += 'layer = "flat.csv"\nlayer_model = "berns"\nspecular = "excluded"\npolarization = "full"\n'
    words = ["a.csv", "--material", "interfaced", "--reflectance", "flat.csv", "--index", "PMMA-Sultanova"]
    words += ["--layer", "flat.csv", "--layer-model", "berns", "--specular", "excluded", "--polarization", "full"]
    mine, _, free_here, options = configured(ONE + scene)
    yours, _, free_there, others = asked(*words)
    assert_same(mine, yours)
    assert_parameters(free_here, free_there, mine)
    assert options == {"tolerance": 1e-8}
    assert others == {"tolerance": 1e-8, "standard_uncertainty": None}


def test_a_parameter_that_is_not_free_has_the_value_of_the_scene(no_fit: None) -> None:
    gain = "[parameters.gain]\n"
    assert configured(ONE + MATTE + "angle_deg = 45\n" + gain)[0].surface.angle == math.radians(45)
    assert configured(ONE + ROUGH + "roughness = 0.3\n" + gain)[0].surface.roughness == 0.3
    found = configured(ONE + ROUGH.replace("beckmann", "gaussian") + "roughness = 0.3\n" + gain)[0]
    assert_same(found.surface, vc.GaussianGrooves(0.3))


def test_samples_may_differ_between_measurements(no_fit: None) -> None:
    text = ONE + '[[measurement]]\nfile = "b.csv"\nreflectance = "flat.csv"\nangle_deg = 30\n'
    text += MATTE + 'angle_deg = 60\n[parameters.angle]\nmeasurements = ["a"]\n'
    scenes, _, _, _ = configured(text)
    assert_same(scenes["a"].material, GRAY)
    assert_same(scenes["b"].material, vc.Lambertian(NM / 1000))
    assert (scenes["a"].surface.angle, scenes["b"].surface.angle) == (math.radians(60), math.radians(30))


def test_what_a_measurement_is_told(no_fit: None, folder: Path) -> None:
    (folder / "sub").mkdir()
    (folder / "sub" / "table.csv").write_text(
        "wavelength_nm,x,y\n500,30,2\n600,40,2\n700,50,2\n", encoding="utf-8"
    )
    text = '[[measurement]]\nfile = "sub/table.csv"\nname = "sphere"\ncolumn = "x"\nreflectance_unit = "percent"\n'
    text += (
        'uncertainty = 0.004\nwavelengths_nm = [450, 650]\n[[measurement]]\nfile = "b.csv"\nuncertainty = 0.01\n'
    )
    _, measurements, _, _ = configured(text + MATTE)
    assert list(measurements) == ["sphere", "b"]
    sphere = measurements["sphere"]
    np.testing.assert_array_equal(sphere.wavelengths_nm, [500, 600])
    np.testing.assert_allclose(sphere.reflectance_factor, [[0.3, 0.4]], rtol=1e-15)
    np.testing.assert_array_equal(sphere.standard_uncertainty, [[0.004, 0.004]])


@pytest.mark.parametrize("uncertainty", ["", "uncertainty = 0.01\n"])
def test_masked_wavelengths_are_left_out(no_fit: None, uncertainty: str) -> None:
    text = f"{ONE}masked_nm = [[440, 460], [600, 600], [649, 700]]\n{uncertainty}{MATTE}"
    _, m, _, _ = configured(text)
    np.testing.assert_array_equal(m.wavelengths_nm, [500, 550])
    np.testing.assert_array_equal(m.reflectance_factor, Measurement.read("a.csv").reflectance_factor[:, 1:3])
    # With a shift, which needs neighbors, they stay as missing ones.
    _, m, _, _ = configured(text + "[parameters.angle]\n[parameters.wavelength_shift]\n")
    np.testing.assert_array_equal(m.wavelengths_nm, NM)
    np.testing.assert_array_equal(np.isnan(m.reflectance_factor), [[True, False, False, True, True]])


def test_file_names_start_at_the_config(no_fit: None, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("fit.toml").write_text(ONE + MATTE.replace("0.5", '"flat.csv"'), encoding="utf-8-sig")
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir(folder / "elsewhere")
    scene, m, _, _ = asked("--config", "../fit.toml")
    assert_same(scene.material, vc.Lambertian(NM / 1000))
    np.testing.assert_array_equal(m.reflectance_factor, Measurement.read("../a.csv").reflectance_factor)


def test_most_steps(no_fit: None) -> None:
    given = asked("a.csv", "--material", "lambertian", "--reflectance", "0.5", "--max-steps", "200")[3]
    assert given["max_steps"] == 200


def test_options_of_the_fit(no_fit: None) -> None:
    text = f"{ONE}{MATTE}[fit]\ntolerance = 1e-6\nuncertainty = 0.01\nmax_steps = 20\n"
    expected = {"tolerance": 1e-6, "standard_uncertainty": 0.01, "max_steps": 20}
    assert configured(text)[3] == expected
    assert configured(text, "--tolerance", "1e-4")[3] == expected | {"tolerance": 1e-4}


def test_a_measurement_on_the_command_line_stands_for_the_only_one(no_fit: None) -> None:
    for table in ("", "[[measurement]]\nmasked_nm = [[440, 460]]\n"):
        _, m, _, _ = configured(table + MATTE, "b.csv")
        expected = Measurement.read("b.csv").reflectance_factor[:, bool(table) :]
        np.testing.assert_array_equal(m.reflectance_factor, expected)


def test_the_answer_goes_beside_the_config_or_the_measurement(folder: Path) -> None:
    Path("fit.v2.toml").write_text(MATTE, encoding="utf-8")
    assert config.read("fit.v2.toml", "b.csv").folder == Path("b-fit")
    Path("fit.v2.toml").write_text(GOOD, encoding="utf-8")
    assert config.read(str(folder / "fit.v2.toml")).folder == folder / "fit.v2-fit"


# What a config file must not say. Each line: what replaces the text of a good one, and what is said.

GOOD = TWO + MATTE + "[parameters.angle]\nlower_deg = 10\n[fit]\ntolerance = 1e-6\n"


REFUSED: dict[str, list[tuple[str, str]]] = {
    "[fit]": [
        ("[fits]", "fits: unknown key; did you mean fit?"),
        ("[x]", "x: unknown key; expected one of: measurement, scene, parameters, fit"),
    ],
    "tolerance": [
        ("tolerence", "fit.tolerence: unknown key; did you mean tolerance?"),
    ],
    "material": [
        ("materiel", "scene.materiel: unknown key; did you mean material?"),
    ],
    "reflectance =": [
        ("albedo =", "scene.albedo: unknown key; expected one of: surface, material, index"),
    ],
    "lower_deg": [
        ("lower_degg", "parameters.angle.lower_degg: unknown key; did you mean lower_deg?"),
    ],
    "parameters.angle": [
        ("parameters.angel", "parameters.angel: unknown key; did you mean angle?"),
        ("parameters.gain", "gain.lower_deg: unknown key; expected one of: prior, measurements"),
        ("parameters.roughness", "roughness.lower_deg: unknown key"),
    ],
    'file = "b.csv"': [
        ('fiel = "b.csv"', "measurement[2].fiel: unknown key; did you mean file?"),
        ('name = "b"', "measurement[2].file: missing; expected the name of a measurement file"),
    ],
    TWO: [
        ("measurement = []\n", "measurement: missing; expected [[measurement]] with a file"),
        ("measurement = 3\n", "measurement: 3; expected [[measurement]], in double brackets"),
        ('[measurement]\nfile = "a.csv"\n', "measurement: a table; expected [[measurement]], in double brackets"),
        ("", "measurement: missing; expected [[measurement]] with a file, or MEASUREMENT on the command"),
    ],
    '"b.csv"': [
        ("7", "measurement[2].file: 7; expected text in quotes"),
        ('"c.csv"', "measurement[2]: c.csv: no such file"),
        ('"."', "measurement[2]: .: is a directory; expected a measurement file"),
        ('"a.csv"', "measurement[2].name: 'a' is the name of measurement[1] too; expected distinct names"),
        ('"b.csv"\nname = "a"', "measurement[2].name: 'a' is the name of measurement[1] too"),
        ('"b.csv"\nname = ""', "measurement[2].name: the text ''; expected some text on one line"),
        ('"b.csv"\nreflectance_unit = "%"', "reflectance_unit: the text '%'; expected one of: fraction"),
        ('"b.csv"\nwavelengths_nm = [700, 400]', "wavelengths_nm: [700, 400]; expected [low, high]"),
        ('"b.csv"\nwavelengths_nm = 400', "measurement[2].wavelengths_nm: 400; expected [low, high]"),
        ('"b.csv"\nwavelengths_nm = [1, 2]', "measurement[2].wavelengths_nm: no wavelength lies within 1"),
        ('"b.csv"\nmasked_nm = [400, 450]', "measurement[2].masked_nm[1]: 400; expected [low, high]"),
        ('"b.csv"\nmasked_nm = []', "measurement[2].masked_nm: an empty list; expected a list of ranges"),
        ('"b.csv"\nmasked_nm = [[1, 2]]', "measurement[2].masked_nm[1]: no wavelength lies within 1 to 2"),
        ('"b.csv"\nmasked_nm = [[1, 1e3]]', "measurement[2].masked_nm: no wavelength is left"),
        ('"b.csv"\nuncertainty = 3', "measurement[2].uncertainty: 3; expected a number above 0 and at"),
        ('"b.csv"\nspecular = "excluded"', "measurement[2]: measurement[2].specular belongs to scene.mat"),
        ('"b.csv"\nangle_deg = 200', "measurement[2].angle_deg: 200; expected a dihedral angle above 0"),
    ],
    '"lambertian"': [
        ('"lambertien"', "scene.material: the text 'lambertien' (did you mean 'lambertian'?); expect"),
    ],
    'material = "lambertian"\n': [
        ("", "scene.material: missing; expected one of: specular, lambertian, interfaced"),
    ],
    "reflectance = 0.5\n": [
        ("", "measurement[1]: scene.material lambertian needs scene.reflectance: a number from"),
    ],
    "= 0.5": [
        ("= true", "scene.reflectance: true; expected a number, or the text of a name or a file"),
        ("= nan", "scene.reflectance: nan; expected a number"),
        ("= 50", "scene.reflectance 50: expected a fraction from 0 to 1: did you pass percent?"),
        ('= "flat.csv"\nresample = 1', "scene.resample: 1; expected true or false"),
        ('= "c.csv"', "measurement[1]: c.csv: no such file"),
        ("= 0.5\nindex = 1.5", "scene.index belongs to scene.material specular or interfaced, not to lamb"),
        ("= 0.5\nroughness = 1", "scene.roughness belongs to scene.surface beckmann or gaussian, not to v-"),
        ('= 0.5\nangle_deg = "45deg"', "scene.angle_deg: the text '45deg'; expected a number"),
    ],
    "[parameters.angle]\nlower_deg = 10": [
        ("[parameters.gain]", "angle is neither free nor said: expected [param"),
        ("[parameters]\nangle = 3", "parameters.angle: 3; expected a table"),
        ("[parameters]\nangle = []", "parameters.angle: a list; expected a table"),
        ("[parameters]\nangle = [3]", "parameters.angle[1]: 3; expected a table"),
    ],
    "= 0.5\n[parameters.angle]\nlower_deg = 10": [
        ("= 0.5\nangle_deg = 9", "scene.angle_deg: leaves nothing to"),
    ],
    "lower_deg = 10": [
        ("[parameters.index]", "parameters.index belongs to scene.material specular or interfaced"),
        ("[parameters.coverage]", "parameters.coverage belongs to scene.material interfaced, not"),
        ("lower_deg = 200", "parameters.angle: dihedral angles from 200 to 180 degrees; expected 0"),
        ('lower_deg = "10"', "parameters.angle.lower_deg: the text '10'; expected a number"),
        ("[parameters.reflectance]\nsmooth_nm = 0", "smooth_nm: 0; expected a number of nanom"),
        ("[parameters.reflectance]\nprior = 3", "parameters.reflectance.prior: 3; expected a numb"),
        ("[parameters.reflectance]\nprior = 0.1\nsmooth_nm = 9", "expected one of prior and form"),
        ("[parameters.tilt]\nlimit_deg = 60", "parameters.tilt: tilt up to 60 degrees; expected"),
        ("prior = 3", 'parameters.angle.prior: 3; expected "none", or a table such as'),
        ("prior = { mean = 3 }", "parameters.angle.prior: a table without kind; expected"),
        ('prior = { kind = "gauss" }', "prior.kind: the text 'gauss'; expected one of: normal, l"),
        ('prior = { kind = "normal", mean = 3 }', "parameters.angle.prior.standard_deviation: missing; expected"),
        ('prior = { kind = "normal", mean = 3, sigma = 1 }', "prior.sigma: unknown key of a normal prior; expect"),
        ('prior = { kind = "uniform", lower = 3, upper = 2 }', "parameters.angle.prior: Uniform(lower=3.0, upper"),
        ('measurements = "all"', "measurements: the text 'all'; expected one of: shared, separate"),
        ('measurements = ["a", "c"]', "parameters.angle.measurements[2]: no measurement is named 'c'; expected s"),
        ('measurements = ["a", "a"]', "angle.measurements[2]: 'a' is given twice"),
        ('measurements = ["a"]', "measurement[2]: angle is neither free nor said: expected"),
    ],
    "1e-6": [
        ("-1e-6", "fit.tolerance: -1e-06; expected a number above 0 and at most 1"),
        ("1e-6\nmax_steps = 1.5", "fit.max_steps: 1.5; expected a whole number of at least 1"),
    ],
}


@pytest.mark.parametrize(("old", "new", "said"), [(old, *row) for old in REFUSED for row in REFUSED[old]])
def test_config_refuses(capsys: pytest.CaptureFixture[str], no_fit: None, old: str, new: str, said: str) -> None:
    before, found, after = GOOD.rpartition(old)
    assert found
    message = refused(capsys, before + new + after)
    assert message.startswith("fit.toml: ")
    assert said in message


def test_the_good_config_is_good(no_fit: None) -> None:
    assert list(configured(GOOD)[1]) == ["a", "b"]


INDEX = ONE + '[scene]\nmaterial = "specular"\nindex = "Au-Johnson"\n[parameters.angle]\n[parameters.index]\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            INDEX,
            "fit.toml: scene.index Au-Johnson: expected a number such as 1.5, or none: one real index for all",
        ),
        (
            INDEX + CAUCHY,
            "scene.index Au-Johnson: k is 1.9155 at 450 nm; expected k = 0, because n alone is free",
        ),
        (INDEX + 'form = "cauchi"', "parameters.index.form: the text 'cauchi' (did you mean 'cauchy'?); expected"),
        (INDEX + 'form = "cauchy"\nb = 1', "index.b: unknown key of the form cauchy; "),
        (
            INDEX + 'form = "cauchy"\na = [2, 1]',
            "parameters.index.a: [2, 1]; expected [low, high] with low < high",
        ),
        (
            INDEX + 'form = "cauchy"\na = "x"',
            "index.a: the text 'x'; expected a number (held) or [low, high] (free)",
        ),
        (
            INDEX + 'form = "cauchy"\na = 1\nb_um2 = 0',
            "parameters.index: Cauchy: no coefficient is a range (low, hi",
        ),
        (INDEX + 'form = "sellmeier"\nb = [1]', "parameters.index: b or c_um2 is missing; expected both"),
        (
            INDEX + 'form = "drude-lorentz"\noscillators = [[1, 2]]',
            "parameters.index.oscillators[1]: 2 coefficients; expected [strength, energy_ev, width_ev]",
        ),
        (INDEX + 'form = "n-and-k"\nlower = 0.1', "parameters.index.lower: 0.1; expected two numbers, [n, k]"),
        (
            (INDEX + 'form = "n-and-k"').replace('index = "Au-Johnson"\n', ""),
            "scene.material specular needs scene.index: a table's name, a number or a file",
        ),
        (
            (INDEX + 'form = "per-wavelength"\nprior = 0.1').replace('index = "Au-Johnson"\n', ""),
            "parameters.index.prior: is around the scene's own; expected scene.index with it",
        ),
        (INDEX.replace("Au-J", "Au-j"), "scene.index Au-johnson: expected a number such as 1.5"),
        (
            ONE + MIRROR.replace("Au-J", "Au-j"),
            "scene.index Au-johnson: neither a number, nor a bundled table, nor ",
        ),
        (ONE.replace("a.csv", "fit.toml") + MIRROR, "fit.toml:"),
        (
            ONE + "uncertainty = 0.1\n" + MATTE + "[fit]\nuncertainty = 0.1",
            "measurement[1].uncertainty: beside fit.u",
        ),
        (
            ONE + INKED + 'layer_model = "berns"',
            "scene.layer_model beside scene.coverage: a halftone has no such mo",
        ),
    ],
)
def test_config_refuses_contradictions(
    capsys: pytest.CaptureFixture[str], no_fit: None, text: str, said: str
) -> None:
    assert said in refused(capsys, text)


def test_broken_files_are_told_with_line_and_column(capsys: pytest.CaptureFixture[str], no_fit: None) -> None:
    said = refused(capsys, '[scene]\nmaterial = "specular\n')
    assert said.startswith("fit.toml: ")
    assert "line 2, column 21" in said
    assert "line 3" in refused(capsys, "[scene]\nindex = 1\nindex = 2\n")
    assert "fit.toml: lists or tables are nested too deeply" in refused(capsys, f"a = {'[' * 5000}")
    Path("utf16.toml").write_text(GOOD, encoding="utf-16")
    assert refusal(capsys, "--config", "utf16.toml").startswith("utf16.toml: the text is not UTF-8; expected")
    assert refusal(capsys, "--config", "gone.toml") == "gone.toml: no such file; expected a config file (TOML)"
    assert refusal(capsys, "--config", ".") == ".: is a directory; expected a config file (TOML)"


@pytest.mark.parametrize(
    "option",
    [
        ["--material", "specular"],
        ["--free", "angle"],
        ["--fix", "angle=45"],
        ["--no-priors"],
        ["--surface", "v-grooves"],
        ["--resample"],
        ["--uncertainty", "0.1"],
        ["--coverage", "0"],
    ],
)
def test_options_that_a_config_stands_for_are_refused(
    capsys: pytest.CaptureFixture[str], no_fit: None, option: list[str]
) -> None:
    assert refused(capsys, GOOD, *option).startswith(
        f"{option[0]} beside --config fit.toml: expected it in the file"
    )


def test_a_measurement_beside_a_config_that_names_its_own_is_refused(
    capsys: pytest.CaptureFixture[str], no_fit: None
) -> None:
    said = refused(capsys, GOOD, "b.csv")
    assert said == "fit.toml: MEASUREMENT b.csv beside a config that names its own; expected one of them"
    two = "[[measurement]]\n[[measurement]]\n"
    assert "a config that has several [[measurement]]; expected" in refused(capsys, two + MATTE, "b.csv")


def test_what_the_fit_itself_refuses_is_told_in_the_words_of_the_config(
    capsys: pytest.CaptureFixture[str],
) -> None:
    mixed = ONE + "uncertainty = 0.01\n" + TWO.removeprefix(ONE) + MATTE
    assert refused(capsys, mixed) == (
        "fit.toml: some measurements state an uncertainty and some do not; expected all or none, or uncertainty "
        "in [fit]"
    )


# Fits in earnest.


def fitted(capsys: pytest.CaptureFixture[str], text: str) -> dict[str, Any]:
    Path("fit.toml").write_text(text, encoding="utf-8")
    assert main(["fit", "--config", "fit.toml", "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out == Path("fit-fit/fit.json").read_text(encoding="utf-8")
    assert Path("fit-fit/fit.png").read_bytes().startswith(b"\x89PNG")
    answer: dict[str, Any] = json.loads(out)
    assert answer["status"] == "converged"
    assert answer["describes_data"] is True
    return answer


def test_orange_of_unknown_reflectance(capsys: pytest.CaptureFixture[str]) -> None:
    text = f'[[measurement]]\nfile = "{ORANGE}"\nmasked_nm = [[400, 440], [580, 590]]\n[scene]\n'
    text += 'material = "lambertian"\n[parameters.angle]\nlower_deg = 30\n[parameters.reflectance]\n'
    text += "[fit]\ntolerance = 1e-4\n"
    answer = fitted(capsys, text)
    ((low, high),) = answer["parameters"]["angle"]["interval_95"]
    assert low < 60 < high
    found = answer["parameters"]["reflectance"]
    assert found["wavelength_nm"] == [*range(450, 571, 10), *range(600, 701, 10)]
    nm, flat = np.loadtxt(FLAT, delimiter=",", skiprows=3, unpack=True)
    truth = flat[np.isin(nm, found["wavelength_nm"])]
    apart = (np.array(found["value"]) - truth) / np.array(found["standard_error"])
    assert np.abs(apart).max() < 4
    # 24 values that share the error of the angle: its square is 1 on average, 2 at one in a thousand.
    assert np.mean(apart**2) < 2.5


def test_gold_of_unknown_tilt(capsys: pytest.CaptureFixture[str]) -> None:
    text = f'[[measurement]]\nfile = "{GOLD}"\nwavelengths_nm = [500, 600]\nmasked_nm = [[580, 590]]\n{MIRROR}'
    text += "[parameters.angle]\nlower_deg = 40\nupper_deg = 50\n[parameters.tilt]\n[parameters.gain]\n"
    text += "[parameters.offset]\n[fit]\ntolerance = 1e-5\n"
    answer = fitted(capsys, text)
    truth = {"angle": 45, "tilt_across": 0, "tilt_along": 0, "gain": 1, "offset": 0}
    assert set(answer["parameters"]) == set(truth)
    for name, value in truth.items():
        found = answer["parameters"][name]
        assert found["interval_95"][0][0] < value < found["interval_95"][-1][1]
    directions = len(Measurement.read(GOLD).polar)
    assert answer["degrees_of_freedom"] == 9 * directions - 1
