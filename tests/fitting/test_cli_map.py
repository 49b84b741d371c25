"""`vcavity map`: what it writes reads back, in both formats; the picture; how it says no."""

import os
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import matplotlib
import matplotlib.style
import numpy as np
import pytest
from scipy.io import netcdf_file  # type: ignore[import-untyped]

import vcavity_jax as vc
from fitting import map_plot, plots
from fitting.cli import BAD_INPUT, arguments, main
from fitting.map_plot import plot_maps

FLAT = ["--angle", "180", "--material", "lambertian", "--reflectance", "0.5", "--size", "6"]
MIRROR = ["--angle", "60", "--material", "specular", "--index", "Au-Johnson", "--size", "12"]
NM = np.arange(380.0, 731.0, 10.0)


def written(capsys: pytest.CaptureFixture[str], *argv: str) -> list[str]:
    assert main(["map", *argv]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return out.splitlines()


def refusal(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    assert main(["map", *argv]) == BAD_INPUT
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    return err


def test_help_names_what_is_known(capsys: pytest.CaptureFixture[str]) -> None:
    assert written(capsys, "--help")[0].startswith("usage: vcavity map")
    assert arguments.ILLUMINANTS == vc.colorimetry.ILLUMINANTS
    assert tuple(f"CIE {year}" for year in ("1931", "1964")) == vc.colorimetry.OBSERVERS


def test_both_formats_hold_the_map(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    base = tmp_path / "gold.v2"
    assert written(capsys, *MIRROR, "--output", str(base)) == [f"wrote {base}.png", f"wrote {base}.npz"]
    assert written(capsys, *MIRROR, "--output", str(base), "--format", "netcdf")[1] == f"wrote {base}.nc"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["gold.v2.nc", "gold.v2.npz", "gold.v2.png"]
    assert Path(f"{base}.png").read_bytes().startswith(b"\x89PNG")

    material = vc.Specular(jnp.asarray(vc.materials.refractive_index("Au-Johnson", NM)))
    scene = vc.Scene(vc.VGrooves(np.deg2rad(60.0)), material, vc.Diffuse(), vc.View())
    chart = vc.reflectance_map(scene, 12)
    expected = {
        "wavelength_nm": NM,
        "polar_deg": np.rad2deg(chart.polar),
        "azimuth_deg": np.rad2deg(chart.azimuth),
        "reflectance_factor": chart.reflectance_factor,
        "srgb": chart.srgb(NM),
        "reflections": chart.reflections,
    }
    # Of scipy, which maps files into memory and complains about it.
    with np.load(f"{base}.npz") as npz, netcdf_file(f"{base}.nc", mmap=False) as netcdf:
        for name, values in expected.items():
            np.testing.assert_array_equal(npz[name], values)
            np.testing.assert_array_equal(netcdf.variables[name][:], values)
            assert netcdf.variables[name].long_name
        assert str(npz["title"]) == netcdf.title.decode() == "v-grooves, angle 60 deg, specular, index Au-Johnson"
        assert (str(npz["illumination"]), netcdf.illuminant) == ("diffuse", b"D65")
        assert netcdf.variables["reflectance_factor"].dimensions == ("v", "u", "wavelength_nm")
        assert netcdf.variables["polar_deg"].units == b"degree"
        u, v = np.meshgrid(netcdf.variables["u"][:], netcdf.variables["v"][:])
        radius = 2 * np.sin(np.deg2rad(npz["polar_deg"]) / 2)
        inside = np.isfinite(radius)
        np.testing.assert_allclose(
            (radius * np.sin(np.deg2rad(npz["azimuth_deg"])))[inside], v[inside], atol=1e-14
        )
        np.testing.assert_allclose(np.hypot(u, v)[inside], radius[inside], atol=1e-14)


def test_options_reach_the_model(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    base = str(tmp_path / "matte")
    options = ["--illumination", "directional:30,90", "--wavelengths", "420:680:20", "--partial"]
    written(capsys, *FLAT, *options, "--illuminant", "A", "--observer", "1964", "--output", base)
    with np.load(f"{base}.npz") as npz:
        inside = np.isfinite(npz["polar_deg"])
        np.testing.assert_allclose(npz["reflectance_factor"][inside], 0.5, atol=1e-6)
        np.testing.assert_allclose(npz["srgb"][inside], 0.735357, atol=1e-5)  # a gray stays gray
        assert str(npz["illumination"]) == "directional:30,90"
        assert (str(npz["illuminant"]), str(npz["observer"])) == ("A", "CIE 1964")
        assert "reflections" not in npz


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["--size", "0"], "argument --size: '0': expected a whole number"),
        (["--size", "2.5"], "argument --size"),
        (["--illuminant", "D93"], "argument --illuminant: invalid choice: 'D93'"),
        (["--observer", "2"], "argument --observer"),
        (["--wavelengths", "450:650:10"], "do not cover 400 to 700 nm: expected the visible range, or --partial"),
        (["--wavelengths", "400,450,700"], "not equally spaced"),
        (["--wavelengths", "345:745:10"], "345 nm is outside the tables"),
        (["--output", "gone/map"], "there is no folder gone"),
        (["--output", "map.png"], "expected a name without its ending; 'map' writes map.png and map.npz"),
        (["--output", "."], "is a folder"),
        (["--roughness", "1"], "--roughness belongs to"),
        (["--format", "hdf5"], "argument --format"),
    ],
)
def test_map_refuses(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    argv: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in refusal(capsys, *FLAT, *argv)
    assert list(tmp_path.iterdir()) == []


def test_scenes_without_a_map_are_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "needs --angle" in refusal(capsys, *FLAT[2:])
    assert "delta function" in refusal(capsys, *MIRROR, "--illumination", "directional:0,0")
    plastic = [*MIRROR[:5], "PMMA-Sultanova"]
    assert "outside the table's range, 436.8 nm" in refusal(capsys, *plastic)
    assert list(tmp_path.iterdir()) == []


def test_full_disk_leaves_the_old_files(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for ending in ("png", "npz"):
        (tmp_path / f"map.{ending}").write_bytes(b"old")

    def full(source: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    assert "cannot write (No space left on device)" in refusal(capsys, *FLAT, "--output", str(tmp_path / "map"))
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"old", b"old"]


def chart(degrees: float, material: Any = None) -> vc.ReflectanceMap:
    """A map whose colors do not matter."""
    scene = vc.Scene(
        vc.VGrooves(np.deg2rad(degrees)), material or vc.Specular(np.full(36, 1.5)), vc.Diffuse(), vc.View()
    )
    return vc.reflectance_map(scene, 48)


MATTE = vc.Lambertian(np.full(36, 0.5))


def words(*maps: vc.ReflectanceMap, title: str = "title") -> tuple[Any, list[Any]]:
    """The figure, drawn, and all text on it."""
    colors = [np.asarray(one.srgb(NM)) for one in maps]
    with matplotlib.style.context(["default", plots._STYLE]):
        figure = map_plot._draw(maps, colors, [title] * len(maps))
        figure.draw_without_rendering()
    found = figure.findobj(matplotlib.text.Text)
    return figure, [text for text in found if text.get_text() and text.get_visible()]


@pytest.mark.parametrize("angles", [(45,), (10,), (60, 90, 120, 180), (20, 100)])
def test_every_word_lies_on_the_figure_and_clear_of_the_others(angles: tuple[float, ...]) -> None:
    figure, texts = words(*map(chart, angles))
    assert min(text.get_fontsize() for text in texts) >= 8
    boxes = {f"{i}: {text.get_text()}": text.get_window_extent() for i, text in enumerate(texts)}
    for name, box in boxes.items():
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1, name
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1, name
        for other, its in boxes.items():
            assert name == other or not box.padded(-1).overlaps(its.padded(-1)), (name, other)


def test_numbers_stand_in_the_regions_or_on_a_bar() -> None:
    wide, narrow, matte = (
        [text.get_text() for text in words(one)[1]] for one in (chart(60), chart(6), chart(180, MATTE))
    )
    assert [wide.count(str(number)) for number in (1, 2, 3, 4)] == [2, 2, 1, 0]
    assert "28" in narrow  # of 30; the bar names every third
    assert {"title", "color in sRGB", "30°", "60°", "180°"} <= set(matte)
    assert "most reflections" not in matte


def test_plot_refuses(tmp_path: Path) -> None:
    one = chart(180, MATTE)
    with pytest.raises(ValueError, match="no maps"):
        plot_maps([], NM, tmp_path / "map.png")
    with pytest.raises(ValueError, match="1 titles for 2 maps"):
        plot_maps([one, one], NM, tmp_path / "map.png", titles=["one"])
    with pytest.raises(ValueError, match=r"ending is '\.jpg'"):
        plot_maps([one], NM, tmp_path / "map.jpg")
    assert list(tmp_path.iterdir()) == []
