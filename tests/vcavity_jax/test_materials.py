"""Refractive indices: bundled tables, users' files, dispersion formulas and every refusal."""

import importlib.resources
import math
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vcavity_jax import materials

FOLDER = importlib.resources.files("vcavity_jax") / "data" / "refractive-index"
POLYMERS = {"PMMA-Sultanova", "polycarbonate-Sultanova"}
BUNDLED = (
    *("Ag-Johnson", "Ag-McPeak", "Ag-Wu", "Al-McPeak", "Al-Rakic", "Au-Johnson", "Au-McPeak", "Cr-Johnson"),
    *("Cu-Johnson", "Cu-McPeak", "Fe-Johnson", "Ni-Johnson", "PMMA-Sultanova", "Si-Aspnes", "Si-Green-2008"),
    *("Ti-Johnson", "polycarbonate-Sultanova"),
)
TABULATED = [name for name in BUNDLED if name not in POLYMERS]


def rows_of(name: str) -> np.ndarray:
    """Numbers of a bundled table, read without the library: every line of three numbers."""
    number = r"[0-9.]+(?:[eE][+-]?[0-9]+)?"
    text = (FOLDER / f"{name}.yml").read_text(encoding="utf-8")
    found = re.findall(rf"^\s+({number})\s+({number})\s+({number})\s*$", text, flags=re.MULTILINE)
    rows = np.array(found, dtype=float)
    assert len(rows) > 40
    return rows


def write(folder: Path, content: str | bytes, name: str = "index.yml") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def record(kind: str, rows: list[str]) -> str:
    body = "".join(f"        {row}\n" for row in rows)
    return f"DATA:\n  - type: tabulated {kind}\n    data: |\n{body}"


def formula(number: int, coefficients: str, limits: str = "0.4 0.8") -> str:
    head = f"DATA:\n  - type: formula {number}\n"
    return f"{head}    wavelength_range: {limits}\n    coefficients: {coefficients}\n"


# --- bundled materials ---------------------------------------------------------------------------------


def test_names_are_the_bundled_files_sorted() -> None:
    assert materials.names() == BUNDLED


@pytest.mark.parametrize("name", TABULATED)
def test_values_at_nodes_are_exact(name: str) -> None:
    rows = rows_of(name)
    rows = rows[rows[:, 0] >= 0.02]
    index = materials.refractive_index(name, rows[:, 0] * 1000)
    assert index.dtype == np.complex128
    # Only the rounding of 1000 λ is left, amplified by the steepest slope of a table (Si near 290 nm).
    np.testing.assert_allclose(index.real, rows[:, 1], rtol=1e-13)
    np.testing.assert_allclose(index.imag, rows[:, 2], rtol=1e-13)


def test_a_wavelength_as_written_gives_the_digits_as_written() -> None:
    assert materials.refractive_index("Au-Johnson", [187.9, 548.6, 1937.0]).tolist() == [
        1.28 + 1.188j,
        0.43 + 2.455j,
        0.92 + 13.78j,
    ]


@pytest.mark.parametrize("name", TABULATED)
def test_midpoints_are_the_mean_of_the_neighbors(name: str) -> None:
    rows = rows_of(name)
    rows = rows[rows[:, 0] >= 0.02]
    middle = (rows[1:] + rows[:-1]) / 2
    index = materials.refractive_index(name, middle[:, 0] * 1000)
    np.testing.assert_allclose(index.real, middle[:, 1], rtol=1e-12)
    np.testing.assert_allclose(index.imag, middle[:, 2], rtol=1e-12)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(TABULATED), st.floats(0, 1), st.data())
def test_interpolation_stays_between_the_neighbors(name: str, weight: float, data: st.DataObject) -> None:
    rows = rows_of(name)
    rows = rows[rows[:, 0] >= 0.02]
    i = data.draw(st.integers(0, len(rows) - 2))
    wavelength = 1000 * (rows[i, 0] + weight * (rows[i + 1, 0] - rows[i, 0]))
    index = materials.refractive_index(name, wavelength)
    for value, pair in zip((index.real, index.imag), rows[i : i + 2, 1:].T, strict=True):
        assert pair.min() * (1 - 1e-12) <= value <= pair.max() * (1 + 1e-12)


def test_pmma_at_the_sodium_line() -> None:
    # 0.5893² = 0.34727449, less 0.011313 = 0.33596149
    squared = 1 + 1.1819 * 0.34727449 / 0.33596149
    index = materials.refractive_index("PMMA-Sultanova", 589.3)
    assert index == pytest.approx(math.sqrt(squared), rel=1e-14)
    assert index == pytest.approx(1.4906, abs=3e-4)  # 1.4905 here, 1.491 in the tables of optical polymers


@pytest.mark.parametrize("name", BUNDLED)
def test_dtype_and_shape(name: str) -> None:
    expected = np.float64 if name in POLYMERS else np.complex128
    for wavelengths in (550, 550.0, [], [500, 600], np.full((2, 3), 550, dtype=np.float32)):
        index = materials.refractive_index(name, wavelengths)
        assert isinstance(index, np.ndarray)
        assert index.dtype == expected
        assert index.shape == np.shape(wavelengths)


@pytest.mark.parametrize("name", TABULATED)
def test_range_of_a_table(name: str) -> None:
    wavelengths = rows_of(name)[:, 0] * 1000
    assert materials.wavelength_range_nm(name) == pytest.approx((wavelengths[0], wavelengths[-1]), rel=1e-15)


def test_range_of_a_formula_is_correctly_rounded() -> None:
    assert materials.wavelength_range_nm("PMMA-Sultanova") == (436.8, 1052.0)


@pytest.mark.parametrize("name", BUNDLED)
def test_reference_is_plain_text(name: str) -> None:
    reference = materials.reference(name)
    assert re.search(r"\((19|20)\d\d\)", reference)
    assert not re.search(r"[<>\n]|  |&\w+;", reference)


def test_reference_of_gold() -> None:
    assert materials.reference("Au-Johnson") == (
        "P. B. Johnson and R. W. Christy. Optical constants of the noble metals. Phys. Rev. B 6, 4370-4379 (1972)"
    )


def test_data_readme_lists_every_file_with_its_reference() -> None:
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert "refractiveindex.info" in text
    assert "CC0 1.0" in text
    listed = dict(re.findall(r"^\| (\S+)\.yml \| (.+) \|$", text, flags=re.MULTILINE))
    assert listed == {name: materials.reference(name) for name in BUNDLED}


def test_a_returned_array_is_the_callers_own() -> None:
    first = materials.refractive_index("PMMA-Sultanova", [500.0, 600.0])
    kept = first.copy()
    first[:] = 0
    assert np.array_equal(materials.refractive_index("PMMA-Sultanova", [500.0, 600.0]), kept)


def test_yaml_is_imported_only_to_parse() -> None:
    # The package itself may need yaml elsewhere one day, so the module is loaded from its file alone.
    code = (
        "import sys, types; p = types.ModuleType('vcavity_jax'); p.__path__ = [sys.argv[1]];"
        "sys.modules['vcavity_jax'] = p; import vcavity_jax.materials;"
        "print(sorted({'yaml', 'jax'} & set(sys.modules)))"
    )
    folder = str(Path(materials.__file__).parent)
    run = subprocess.run([sys.executable, "-c", code, folder], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Au-Johnsen", "did you mean Au-Johnson"),
        ("au", "did you mean Au-Johnson or Au-McPeak?"),
        ("pmma", "did you mean PMMA-Sultanova?"),
        ("unobtainium", "'unobtainium' is not a bundled material: vcavity_jax.materials.names()"),
        ("", "'' is not a bundled material: vcavity_jax.materials.names()"),
        ("../refractive-index/Au-Johnson", "is not a bundled material"),
    ],
)
@pytest.mark.parametrize(
    "function",
    [lambda name: materials.refractive_index(name, 550), materials.reference, materials.wavelength_range_nm],
)
def test_unknown_name(function: Callable[[str], object], name: str, says: str) -> None:
    with pytest.raises(ValueError, match=re.escape(says)) as caught:
        function(name)
    assert "materials.names()" in str(caught.value)
    assert "\n" not in str(caught.value)


# --- wavelengths ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wavelengths", "says"),
    [
        ([500, 100], "Au-Johnson{}: wavelength 100 nm is outside the table's range, 187.9 nm to 1937 nm"),
        (1937.01, "wavelength 1937.01 nm is outside the table's range, 187.9 nm to 1937 nm"),
        (187.89, "wavelength 187.89 nm is outside"),
        ([0.4, 0.7], "did you pass micrometers"),
        (550e-9, "did you pass micrometers (or meters)?"),
        (19.99, "did you pass micrometers"),
        ([500, np.nan], "nan is not a wavelength"),
        ([500, np.inf], "inf is not a wavelength"),
        ([500, 0], "0.0 is not a wavelength"),
        (-500, "-500.0 is not a wavelength"),
        ("550", "are not real numbers: expected nanometers"),
        ([550j], "are not real numbers: expected nanometers"),
        (True, "are not real numbers: expected nanometers"),
    ],
)
def test_refused_wavelengths(tmp_path: Path, wavelengths: Any, says: str) -> None:
    with pytest.raises(ValueError, match=re.escape(says.format(""))) as caught:
        materials.refractive_index("Au-Johnson", wavelengths)
    assert "\n" not in str(caught.value)
    path = write(tmp_path, (FOLDER / "Au-Johnson.yml").read_bytes(), "Au-Johnson.yml")
    with pytest.raises(ValueError, match=re.escape(says.format(".yml"))):
        materials.read_index(path, wavelengths)


def test_twenty_nanometers_is_no_longer_taken_for_micrometers() -> None:
    with pytest.raises(ValueError, match="outside the table's range"):
        materials.refractive_index("Au-Johnson", 20)
    assert materials.refractive_index("Al-Rakic", [0.2, 20.0]).shape == (2,)


def test_ends_in_single_precision_count_as_the_ends() -> None:
    below, above = np.float32(436.8), np.float32(187.9)
    assert float(below) < 436.8
    assert materials.refractive_index("PMMA-Sultanova", below) > 1.49
    assert materials.refractive_index("Au-Johnson", above) == pytest.approx(1.28 + 1.188j, abs=1e-6)


# --- users' files --------------------------------------------------------------------------------------

NK = ["0.4 1.5 0.1", "0.5 1.4 0.3", "0.7 1.2 0.7"]


@pytest.mark.parametrize("suffix", [".yml", ".yaml", ".YML"])
def test_read_tabulated_nk(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path, record("nk", NK), f"index{suffix}")
    index = materials.read_index(path, [400, 450, 500, 600, 700])
    np.testing.assert_allclose(index, [1.5 + 0.1j, 1.45 + 0.2j, 1.4 + 0.3j, 1.3 + 0.5j, 1.2 + 0.7j], rtol=1e-15)
    assert np.array_equal(materials.read_index(str(path), 450), index[1])


@pytest.mark.parametrize("name", BUNDLED)
def test_read_index_agrees_with_the_bundled_table(tmp_path: Path, name: str) -> None:
    path = write(tmp_path, (FOLDER / f"{name}.yml").read_bytes())
    wavelengths = np.linspace(437, 800, 7)
    ours = materials.refractive_index(name, wavelengths)
    theirs = materials.read_index(path, wavelengths)
    assert theirs.dtype == ours.dtype
    assert np.array_equal(theirs, ours)


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = write(tmp_path, record("n", ["0.4 1.5", "0.7 1.5"]))
    assert materials.read_index(path, 500) == 1.5
    write(tmp_path, record("n", ["0.4 1.7", "0.7 1.7"]))
    assert materials.read_index(path, 500) == 1.7


def test_n_and_k_tables_on_their_own_grids(tmp_path: Path) -> None:
    extra = record("k", ["0.5 0.2", "0.8 0.5"]).removeprefix("DATA:\n")
    path = write(tmp_path, record("n", ["0.4 1.5", "0.6 1.7"]) + extra)
    np.testing.assert_allclose(materials.read_index(path, [500, 600]), [1.6 + 0.2j, 1.7 + 0.3j], rtol=1e-15)
    for outside in (499, 601):
        with pytest.raises(ValueError, match="range, 500 nm to 600 nm"):
            materials.read_index(path, outside)


def test_formula_for_n_with_table_for_k(tmp_path: Path) -> None:
    extra = record("k", ["0.5 1E-06", "0.6 3E-06"]).removeprefix("DATA:\n")
    path = write(tmp_path, formula(5, "1.5 0.01 -2") + extra)
    index = materials.read_index(path, 550)
    assert index.real == pytest.approx(1.5 + 0.01 / 0.3025, rel=1e-15)
    assert index.imag == pytest.approx(2e-6, rel=1e-12)


def test_the_former_name_of_the_range_is_understood(tmp_path: Path) -> None:
    text = formula(5, "1.5").replace("wavelength_range", "range")
    assert materials.read_index(write(tmp_path, text), [450, 550]).tolist() == [1.5, 1.5]


@pytest.mark.parametrize("rows", [["0.4 1.5 0", "0.7 1.6 0.0"], ["0.4 1.5 -0.0", "0.7 1.6 0"]])
def test_zero_k_gives_real_n(tmp_path: Path, rows: list[str]) -> None:
    index = materials.read_index(write(tmp_path, record("nk", rows)), [400, 700])
    assert index.dtype == np.float64
    assert index.tolist() == [1.5, 1.6]


def test_k_that_is_zero_only_here_keeps_the_table_complex(tmp_path: Path) -> None:
    path = write(tmp_path, record("nk", ["0.4 1.5 0.1", "0.5 1.5 0", "0.7 1.5 0"]))
    assert materials.read_index(path, 600).dtype == np.complex128


def test_zero_k_still_limits_the_range(tmp_path: Path) -> None:
    extra = record("k", ["0.5 0", "0.6 0"]).removeprefix("DATA:\n")
    path = write(tmp_path, formula(5, "1.5") + extra)
    assert materials.read_index(path, 550).dtype == np.float64
    with pytest.raises(ValueError, match="range, 500 nm to 600 nm"):
        materials.read_index(path, 450)


@pytest.mark.parametrize("zero", ["0", "-0.1"])
def test_negative_k_is_conjugated(tmp_path: Path, zero: str) -> None:
    rows = [f"0.4 1.5 {zero}", "0.5 1.4 -0.3", "0.7 1.2 -0.7"]
    index = materials.read_index(write(tmp_path, record("nk", rows)), [400, 500, 600])
    np.testing.assert_allclose(index, [1.5 - 1j * float(zero), 1.4 + 0.3j, 1.3 + 0.5j], rtol=1e-15)


CSV = [
    "wl,n\n0.4,1.5\n0.7,1.2\n\nwl,k\n0.4,0.1\n0.7,0.7\n",
    "wl,n\r\n0.4,1.5\r\n0.7,1.2\r\nwl,k\r\n0.4,0.1\r\n0.7,0.7\r\n",
    "\ufeffwl,n,k\n0.4,1.5,0.1\n0.7,1.2,0.7",
    "wavelength_nm,n,k\n400,1.5,0.1\n700,1.2,0.7\n",
    "# source: me\nWavelength_nm, n, k\n\n# middle\n 4e2 , 1.5 ,-.1\n7.e+2,+1.2,-0.7\n",
    '"wl","n"\n"0.4","1.5"\n"0.7","1.2"\n"wl","k"\n"0.4","0.1"\n"0.7","0.7"\n',
]


@pytest.mark.parametrize("text", CSV)
def test_csv_variants(tmp_path: Path, text: str | bytes) -> None:
    index = materials.read_index(write(tmp_path, text, "index.csv"), [400, 550, 700])
    np.testing.assert_allclose(index, [1.5 + 0.1j, 1.35 + 0.4j, 1.2 + 0.7j], rtol=1e-14)


@pytest.mark.parametrize("text", ["wl,n\n0.4,1.5\n0.7,1.2\n", "wavelength_nm,n\n400,1.5\n700,1.2\n"])
def test_csv_without_k_is_real(tmp_path: Path, text: str | bytes) -> None:
    index = materials.read_index(write(tmp_path, text, "index.csv"), [400, 550, 700])
    assert index.dtype == np.float64
    np.testing.assert_allclose(index, [1.5, 1.35, 1.2], rtol=1e-15)


# --- formulas ------------------------------------------------------------------------------------------

L, P = 0.55, 0.55**2  # the wavelength of the checks in micrometers, and its square
POLE = 1 / (P - 0.028)
R = 0.47856 + 0.07858 * P / (P - 0.08277) - 0.00881 * P

FORMULAS = [
    # Fused silica (Malitson), with its resonances as lengths and as squares.
    (
        1,
        "0 0.6961663 0.0684043 0.4079426 0.1162414 0.8974794 9.896161",
        math.sqrt(
            1
            + 0.6961663 * P / (P - 0.0684043**2)
            + 0.4079426 * P / (P - 0.1162414**2)
            + 0.8974794 * P / (P - 9.896161**2)
        ),
    ),
    (1, "0.25385 0.66405 0.08504", math.sqrt(1.25385 + 0.66405 * P / (P - 0.08504**2))),
    (
        2,
        "0.1 1.03961212 0.00600069867 0.231792344 0.0200179144",
        math.sqrt(1.1 + 1.03961212 * P / (P - 0.00600069867) + 0.231792344 * P / (P - 0.0200179144)),
    ),
    (3, "2.2 -0.01 2 0.012 -2 0.0003 -4", math.sqrt(2.2 - 0.01 * P + 0.012 / P + 0.0003 / P**2)),
    (4, "2.80333 0.94470 2 0.3004 2", math.sqrt(2.80333 + 0.94470 * P / (P - 0.3004**2))),
    (
        4,
        "2.1 3.2 2 400 1 0.0086 0 0.0123 3",
        math.sqrt(2.1 + 3.2 * P / (P - 400) + 0.0086 / (P - 0.0123**3)),
    ),
    (
        4,
        "4.00804 0.079086 0 0.04584 1 0 0 0 1 -0.00085111 2 -0.00000019762 4 0.002 -2 0.01 1",
        math.sqrt(
            4.00804 + 0.079086 / (P - 0.04584) - 0.00085111 * P - 0.00000019762 * P**2 + 0.002 / P + 0.01 * L
        ),
    ),
    (5, "1.41545 0.00369 -2 0.00004 -4", 1.41545 + 0.00369 / P + 0.00004 / P**2),
    (5, "1.5", 1.5),
    (6, "0.00001 0.05792105 238.0185 0.00167917 57.362", None),  # air (Ciddor), checked below
    (
        7,
        "3.41983 0.159906 -0.123109 1.26878e-6 -1.95104e-9 1e-4",
        3.41983 + 0.159906 * POLE - 0.123109 * POLE**2 + 1.26878e-6 * P - 1.95104e-9 * P**2 + 1e-4 * P**3,
    ),
    (7, "3.4 0.16 -0.12", 3.4 + 0.16 * POLE - 0.12 * POLE**2),
    (8, "0.47856 0.07858 0.08277 -0.00881", math.sqrt((1 + 2 * R) / (1 - R))),
    (
        9,
        "2.51527 0.0240 0.0300 0.020 1.52 0.8771",
        math.sqrt(2.51527 + 0.0240 / (P - 0.03) + 0.020 * (L - 1.52) / ((L - 1.52) ** 2 + 0.8771)),
    ),
]


@pytest.mark.parametrize(("number", "coefficients", "expected"), FORMULAS)
def test_formulas(tmp_path: Path, number: int, coefficients: str, expected: float | None) -> None:
    if expected is None:
        expected = 1.00001 + 0.05792105 / (238.0185 - 1 / P) + 0.00167917 / (57.362 - 1 / P)
    index = materials.read_index(write(tmp_path, formula(number, coefficients)), [[550.0]])
    assert index.shape == (1, 1)
    assert index.dtype == np.float64
    assert index[0, 0] == pytest.approx(expected, rel=2e-15)


@pytest.mark.parametrize(
    ("number", "coefficients", "wavelength", "published"),
    [
        # Fused silica at the helium line 587.6 nm [Malitson1965]; N-BK7 there [Schott data sheet].
        (1, "0 0.6961663 0.0684043 0.4079426 0.1162414 0.8974794 9.896161", 587.6, 1.45846),
        (
            2,
            "0 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653",
            587.6,
            1.5168,
        ),
        # Dry air at 15 °C and 101325 Pa [Ciddor1996, eq. 1], whose n at the sodium line is 1.000277.
        (6, "0 0.05792105 238.0185 0.00167917 57.362", 589.3, 1.000277),
    ],
)
def test_formulas_against_published_indices(
    tmp_path: Path, number: int, coefficients: str, wavelength: float, published: float
) -> None:
    # Half a unit of the last published digit, rounded up.
    tolerance = 6e-7 if number == 6 else 6e-6
    index = materials.read_index(write(tmp_path, formula(number, coefficients)), wavelength)
    assert index == pytest.approx(published, abs=tolerance)


@pytest.mark.parametrize(
    ("number", "coefficients"),
    [
        (1, "0 1 0.55"),  # a pole at the wavelength asked for
        (1, "-5"),  # n² < 0
        (3, "-2"),
        (5, "-1.5"),  # n < 0
        (4, "2 1 0 -0.5 0.5"),  # a root of a negative number
        (8, "2 0 0 0"),
        (5, "1 1 -1300"),  # overflow
    ],
)
def test_formula_without_a_real_index_names_the_wavelength(tmp_path: Path, number: int, coefficients: str) -> None:
    path = write(tmp_path, formula(number, coefficients))
    with pytest.raises(ValueError, match=r"index\.yml: the dispersion formula gives no real n > 0 at 550 nm"):
        materials.read_index(path, [550.0, 550.0])


# --- refusals of files ---------------------------------------------------------------------------------

BROKEN_YAML = [
    # text, line (None: no line), what the message says
    ("DATA: [1, 2\nREFERENCES: x\n", 2, "broken YAML"),
    ("DATA:\n\t- type: formula 1\n", 2, "broken YAML"),
    ("a: \x01\n", None, "broken YAML"),
    ("a: 1\n---\nb: 2\n", 2, "broken YAML"),
    ("# nothing\n", None, "only comments; expected a refractiveindex.info record"),
    ("just a sentence\n", 1, "record is not a mapping"),
    ("COMMENTS: none\n", None, "no field DATA"),
    ("DATA: none\n", 1, "DATA is not a list"),
    ("DATA: []\n", 1, "DATA is not a list"),
    ("DATA:\n  - formula 1\n", 2, "DATA entry is not a mapping"),
    ("DATA:\n  - coefficients: 0 1 1\n", 2, "no field type"),
    ("DATA:\n  - type: [formula, 1]\n", 2, "no field type"),
    ("DATA:\n  - type: tabulated nk\n", 2, "no field data"),
    ("DATA: []\nDATA: []\n", 2, "field DATA appears twice"),
    ("DATA:\n  - type: formula 1\n    type: formula 2\n", 3, "field type appears twice"),
    (formula(0, "1"), 2, "type 'formula 0' is unknown; expected 'tabulated nk'"),
    (formula(10, "1"), 2, "type 'formula 10' is unknown; expected 'tabulated nk'"),
    ("DATA:\n  - data: 1\n    type: tabulated n2\n", 3, "type 'tabulated n2' is unknown"),
    (formula(1, "1").replace("coefficients", "c"), 2, "no field coefficients"),
    (formula(1, "1").replace("wavelength_range", "limits"), 2, "no field wavelength_range"),
    (formula(1, "0 one 2"), 2, "formula 1: 'one' is not a number"),
    (formula(1, "0 nan 2"), 2, "'nan' is not a number"),
    (formula(1, "0 1"), 2, "formula 1: found 2 coefficients; expected 1, 3, 5"),
    (formula(4, "0 1 2"), 2, "formula 4: found 3 coefficients; expected 1, 5, 9"),
    (formula(7, "1 2"), 2, "found 2 coefficients; expected 3, 4, 5, 6"),
    (formula(8, "1 2 3"), 2, "found 3 coefficients; expected 4"),
    (formula(9, "1 2 3 4 5"), 2, "found 5 coefficients; expected 6"),
    (formula(5, "1.5", "0.8 0.4"), 2, "wavelength_range is '0.8 0.4'; expected 'shortest longest'"),
    (formula(5, "1.5", "0.4"), 2, "wavelength_range is '0.4'; expected"),
    (formula(5, "1.5", "0 0.8"), 2, "wavelength_range is '0 0.8'; expected"),
    (formula(5, "1.5", "a b"), 2, "'a' is not a number"),
    (record("nk", ["0.4 1.5 0.1", "0.5 1.5"]), 5, "found 2 columns; expected 3: wavelength, n, k"),
    (record("n", ["0.4 1.5 0.1"]), 4, "found 3 columns; expected 2: wavelength, n"),
    (record("n", ["0.4 1.5", "", "0.5 x"]), 6, "'x' is not a number; expected numbers only"),
    (record("n", ["0.4 nan"]), 4, "'nan' is not a number"),
    (record("n", ["0.4 1_5"]), 4, "'1_5' is not a number"),
    (record("n", ["0.4 1e999"]), 4, "'1e999' is not a number"),
    (record("n", ["inf 1.5"]), 4, "'inf' is not a number"),
    (record("n", ["0 1.5"]), 4, "wavelength 0 nm; expected wavelengths above 0"),
    (record("n", ["0.4 1.5", "0.5 0"]), 5, "n = 0; expected n > 0"),
    (record("nk", ["0.4 -1.5 2"]), 4, "n = -1.5; expected n > 0"),
    (record("n", ["0.4 1.5", "0.4 1.6"]), 5, "wavelength 400 nm repeats the row before"),
    (
        record("n", ["0.4 1.5", "0.6 1.6", "0.5 1.7"]),
        6,
        "500 nm follows 600 nm; expected strictly increasing",
    ),
    (record("nk", ["0.4 1 0.1", "0.5 1 0", "0.6 1 -0.1"]), 6, "k = -0.1 changes sign; expected all k >= 0"),
    (record("nk", ["0.4 1 -0.1", "0.5 1 0.2"]), 5, "k = 0.2 changes sign"),
    ("DATA:\n  - type: tabulated n\n    data: ''\n", 2, "no rows; expected at least one"),
    (record("k", ["0.4 1.5"]), None, "gives no n; expected a table or formula for n"),
    (formula(5, "1.5") + formula(5, "1.6").removeprefix("DATA:\n"), 5, "gives n a second time"),
    (record("nk", NK) + record("k", ["0.4 1"]).removeprefix("DATA:\n"), 7, "gives k a second time"),
    (formula(5, "1.5") + record("k", ["0.9 1"]).removeprefix("DATA:\n"), None, "no wavelength in common"),
]

BROKEN_CSV = [
    ("0.4,1.5\n0.5,1.6\n", 1, "'0.4,1.5' is no header; expected 'wl,n'"),
    ("# hi\nlambda;n;k\n", 2, "'lambda;n;k' is no header"),
    ("wavelength_nm,k,n\n", 1, "is no header"),
    ("# hi\n", None, "only comments; expected a header and rows"),
    ("wl,n\n", 1, "no rows; expected at least one"),
    ("wl,n\n0.4,1.5\nwl,k\n", 3, "no rows; expected at least one"),
    ("wl,n\n0.4,1.5\nwl,x\n0.4,1\n", 3, "'wl' is not a number"),
    ("wl,n\n0.4,\n", 2, "'' is not a number"),
    ("wl,n\n0.4\n", 2, "found 1 columns; expected 2"),
    ("wavelength_nm,n,k\n400,1.5\n", 2, "found 2 columns; expected 3"),
    ("wl,n\n0.4,1.5\n\n0.3,1.5\n", 4, "300 nm follows 400 nm; expected strictly increasing"),
    ("wl,n\n0.4,1.5\n0.4,1.5\n", 3, "repeats the row before"),
    ("wl,n\n0.4,-1.5\n", 2, "n = -1.5; expected n > 0"),
    ("wl,n,k\n0.4,1,1\n0.5,1,-1\n", 3, "k = -1 changes sign"),
    ("wl,k\n0.4,1\n", None, "gives no n"),
    ("wl,n\n0.4,1.5\nwl,n\n0.5,1.5\n", 3, "gives n a second time"),
]

BROKEN_ANY = [
    (b"", None, "is empty"),
    (b" \n\n", None, "is empty"),
    (b"\x89PNG\r\n\x1a\n\x00\x00", None, "is not UTF-8 text (byte 0)"),
    (b"PK\x03\x04\x00\x00", None, "is a binary file"),
    ("wl,n\n".encode("utf-16"), None, "is not UTF-8 text"),
]


def refused(path: Path) -> str:
    with pytest.raises(ValueError, match=r"^[^\n]*$") as caught:
        materials.read_index(path, 500)
    return str(caught.value)


@pytest.mark.parametrize(
    ("name", "text", "line", "says"),
    [("broken.yml", *case) for case in BROKEN_YAML + BROKEN_ANY]
    + [("broken.csv", *case) for case in BROKEN_CSV + BROKEN_ANY],
)
def test_broken_files_are_refused_in_one_line(
    tmp_path: Path, name: str, text: str | bytes, line: int | None, says: str
) -> None:
    path = write(tmp_path, text, name)
    message = refused(path)
    place = f"{path}: " if line is None else f"{path}, line {line}: "
    assert message.startswith(place)
    assert says in message


def test_yaml_never_builds_objects(tmp_path: Path) -> None:
    marker = tmp_path / "built"
    text = f'DATA: !!python/object/apply:pathlib.Path.touch [!!python/object/apply:pathlib.Path ["{marker}"]]\n'
    assert "DATA entry is not a mapping" in refused(write(tmp_path, text))
    assert not marker.exists()


def test_deep_nesting_is_refused(tmp_path: Path) -> None:
    assert refused(write(tmp_path, "[" * 20000)).startswith(str(tmp_path / "index.yml"))


def test_missing_file(tmp_path: Path) -> None:
    path = tmp_path / "absent.yml"
    with pytest.raises(FileNotFoundError, match=rf"^{re.escape(str(path))}: no such file; expected an index"):
        materials.read_index(path, 500)


def test_folder_and_unknown_ending(tmp_path: Path) -> None:
    assert "is a directory; expected an index table" in refused(tmp_path)
    path = write(tmp_path, "wl,n\n0.4,1.5\n", "index.xlsx")
    assert "has the ending '.xlsx'; expected .yml, .yaml or .csv" in refused(path)
