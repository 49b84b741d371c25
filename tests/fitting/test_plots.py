"""The picture of a fit: right format, nothing lost or half-written, every word large enough to print."""
# ruff: noqa: RUF001 (the labels are typeset: Greek letters, a real minus)

import dataclasses
import re
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from fitting import Estimate, FitResult, Measurement, Minimum
from fitting.plots import MOST_SERIES, plot_fit


def fitted(
    directions: int = 3,
    wavelengths: int = 31,
    *,
    azimuth_deg: float = 0.0,
    uncertainty: float | None = 0.01,
    profiles: tuple[str, ...] = ("angle",),
) -> FitResult:
    """What a fit returns, made by hand: two minima of the objective, both within the 95 % interval."""
    random = np.random.default_rng(5)
    polar = np.deg2rad(np.linspace(-75, 75, directions))
    azimuth = np.full(directions, np.deg2rad(azimuth_deg))
    azimuth[0] = 0.0
    nm = np.linspace(400, 700, wavelengths)
    predicted = np.cos(polar)[:, None] * (0.5 + 0.3 * np.tanh((nm - 550) / 60))
    measured = predicted + 0.01 * random.standard_normal(predicted.shape)
    if predicted.size > 10:
        measured[0, -1] = np.nan  # a gap
    sigma = None if uncertainty is None else np.where(np.isnan(measured), np.nan, uncertainty)
    m = Measurement(nm, polar, azimuth, measured, sigma)
    estimates, tables = {}, {}
    for name in profiles:
        values = np.linspace(0.1, 3.1, 3001)
        chi_square = 100 + 4e4 * np.minimum((values - 0.8) ** 2, (values - 1.3) ** 2 + 5e-5)
        tables[name] = values, chi_square
        unit = "rad" if name == "angle" else "1"
        estimates[name] = Estimate(0.8, 0.005, [(0.79, 0.81), (1.293, 1.307)], unit)
    nothing = np.zeros((0, 0))
    return FitResult(
        scenes=(None,),
        measurements=(m,),
        labels=("0",),
        estimates=estimates,
        numbers=profiles,
        covariance=nothing,
        correlation=nothing,
        chi_square=100.0,
        degrees_of_freedom=90,
        misfits=(measured - predicted,),
        predictions=(predicted,),
        singular_values=np.zeros(0),
        identifiable=True,
        minima=[Minimum(dict.fromkeys(profiles, at), chi) for at, chi in ((0.8, 100.0), (1.3, 102.0))],
        starts=(),
        profiles=tables,
        rms_misfit=0.01,
        uncertainty_estimated=uncertainty is None,
        describes_data=None,
        warnings=(),
        status="converged",
        message="",
    )


def words(result: FitResult, folder: Path) -> list[str]:
    """All text in the picture."""
    plot_fit(result, folder / "words.svg")
    return re.findall(r"<text[^>]*>([^<]*)</text>", (folder / "words.svg").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("kind", "start"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_ending_decides_the_format_and_bytes_repeat(tmp_path: Path, kind: str, start: bytes) -> None:
    first, second = tmp_path / f"first.{kind}", tmp_path / f"second.{kind.upper()}"
    plot_fit(fitted(), first)
    with mpl.rc_context({"font.size": 30, "axes.grid": True}):  # a user's own style has no say
        plot_fit(fitted(), str(second))
    assert first.read_bytes().startswith(start)
    assert first.read_bytes() == second.read_bytes()
    assert sorted(tmp_path.iterdir()) == [first, second]


def test_caller_keeps_his_settings_and_gets_no_pyplot(tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    plot_fit(fitted(), tmp_path / "fit.png")
    assert dict(mpl.rcParams) == before
    code = "import sys, fitting.plots; sys.exit('matplotlib.pyplot' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_failure_leaves_the_old_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "fit.png"
    path.write_bytes(b"old")

    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as stream:
            stream.write(data[:10])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        plot_fit(fitted(), path)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"old"]


def test_bad_targets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"the ending is '\.jpg'; expected \.png, \.pdf or \.svg"):
        plot_fit(fitted(), tmp_path / "fit.jpg")
    with pytest.raises(FileNotFoundError):
        plot_fit(fitted(), tmp_path / "gone" / "fit.png")
    assert list(tmp_path.iterdir()) == []


def test_panels_name_quantities_and_units(tmp_path: Path) -> None:
    said = words(fitted(), tmp_path)
    for text in ("reflectance factor", "wavelength (nm)", "residual / σ", "Δχ²", "dihedral angle α (deg)"):
        assert text in said
    assert "polar angle of the view at azimuth 0°" in said
    assert {"−75°", "0°", "75°", "95 %"} <= set(said)


def test_without_uncertainty_residuals_are_reflectances(tmp_path: Path) -> None:
    said = words(fitted(uncertainty=None), tmp_path)
    assert "residual" in said
    assert not any("σ" in text for text in said)


def test_many_directions_are_thinned_and_it_says_so(tmp_path: Path) -> None:
    said = words(fitted(20, 91, azimuth_deg=90), tmp_path)
    assert f"view: polar angle, azimuth ({MOST_SERIES} of 20 shown)" in said
    assert {"−75°, 0°", "75°, 90°"} <= set(said)
    assert "(a) points: measured (one in 3), lines: fitted" in said


def test_single_wavelength_is_drawn_over_the_angle(tmp_path: Path) -> None:
    said = words(fitted(9, 1, azimuth_deg=90), tmp_path)
    assert "polar angle of the view (deg)" in said
    assert "azimuth of the view at 400 nm" in said


@pytest.mark.parametrize("profiles", [(), ("roughness",), ("angle", "roughness"), ("tint",)])
def test_each_searched_parameter_has_its_panels(tmp_path: Path, profiles: tuple[str, ...]) -> None:
    said = words(fitted(profiles=profiles), tmp_path)
    labels = {"angle": "dihedral angle α (deg)", "roughness": "roughness m", "tint": "tint"}
    for name, label in labels.items():
        assert said.count(label) == 2 * (name in profiles)


@pytest.mark.parametrize("wavelengths", [1, 31])
def test_all_reflected_light_has_no_angle(tmp_path: Path, wavelengths: int) -> None:
    result = fitted(1, wavelengths, profiles=())
    m, nothing = result.measurement, np.array([np.nan])
    collected = dataclasses.replace(m, polar=nothing, azimuth=nothing, hemispherical=True)
    said = words(dataclasses.replace(result, measurements=(collected,)), tmp_path)
    assert "all directions" in said
    assert "view" in said
    assert not any("°" in text or "nan" in text for text in said)


def test_one_point_is_enough(tmp_path: Path) -> None:
    assert "reflectance factor" in words(fitted(1, 1), tmp_path)


@pytest.mark.parametrize("change", ["no interval", "flat", "gaps", "all gaps", "unbounded"])
def test_fit_without_an_answer_is_drawn(tmp_path: Path, change: str) -> None:
    result = fitted()
    values, chi_square = result.profiles["angle"]
    intervals: list[tuple[float, float]] = result.estimates["angle"].interval_95
    if change == "no interval":
        intervals = []
    elif change == "flat":
        chi_square, intervals = np.full_like(chi_square, 100.0), [(values[0], values[-1])]
    elif change == "unbounded":
        intervals = [(-np.inf, np.inf)]
    else:
        chi_square = np.where(values < (0.7 if change == "gaps" else 9), np.nan, chi_square)
    estimate = dataclasses.replace(result.estimates["angle"], interval_95=intervals)
    result = dataclasses.replace(result, profiles={"angle": (values, chi_square)}, estimates={"angle": estimate})
    panels = {"all gaps": 0, "flat": 1, "unbounded": 1}.get(change, 2)
    assert words(result, tmp_path).count("dihedral angle α (deg)") == panels


def test_every_word_is_large_enough_to_print(tmp_path: Path) -> None:
    plot_fit(fitted(8, 31, profiles=("angle", "roughness")), tmp_path / "fit.svg")
    picture = (tmp_path / "fit.svg").read_text(encoding="utf-8")
    width = float(re.search(r'width="([\d.]+)pt"', picture)[1])
    assert width == pytest.approx(3.5 * 72)  # one column
    sizes = [float(size) for size in re.findall(r"font(?:-size)?: *(?:\w+ )?([\d.]+)px", picture)]
    assert sizes
    assert min(sizes) >= 8
