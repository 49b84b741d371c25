"""Cubes: read as another package reads them, fitted as single spectra are, resumed after a kill; faults named."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import spectral.io.envi as envi
import xarray as xr

import vcavity_jax as vc
from fitting import Measurement, fit, fit_many, free
from fitting.cli import main
from fitting.cubes import CubeResult, fit_cube, open_cube
from fitting.cubes.blocks import STATUSES
from fitting.cubes.fit import _stamp as stamp

WAVES = np.arange(420.0, 701.0, 40.0)
GOLD = vc.materials.refractive_index("Au-Johnson", WAVES)
SCENE = vc.Scene(vc.VGrooves(1.0), vc.Specular(GOLD), vc.Diffuse(), vc.View())
FREE = [free.angle(30, 110), free.gain()]
SIGMA = 0.004
HEADER = {"wavelength": [str(w) for w in WAVES], "wavelength units": "Nanometers"}


@pytest.fixture(scope="module")
def factors() -> np.ndarray:
    """Noisy reflectance factors of 12 lines and 10 samples, whose angle goes from 40 to 85 degrees."""
    random = np.random.default_rng(9)
    rows = [np.asarray(vc.reflectance_factor(SCENE.__class__(vc.VGrooves(a), *_rest()))) for a in _angles()]
    exact = np.broadcast_to(np.stack(rows), (12, 10, WAVES.size))
    return exact * random.normal(1, 0.01, (12, 10, 1)) + SIGMA * random.standard_normal(exact.shape)


def _rest():
    return SCENE.material, SCENE.illumination, SCENE.view


def _angles() -> np.ndarray:
    return np.radians(np.linspace(40, 85, 10))


def saved(path: Path, values: np.ndarray, interleave: str = "bil", **metadata) -> Path:
    header = HEADER | {key.replace("_", " "): value for key, value in metadata.items()}
    envi.save_image(
        str(path), values, dtype=values.dtype, interleave=interleave, ext=".raw", force=True, metadata=header
    )
    return path


@pytest.fixture
def cube(tmp_path: Path, factors: np.ndarray) -> Path:
    return saved(
        tmp_path / "gold.hdr", np.round(factors * 20_000).astype(np.uint16), reflectance_scale_factor="20000"
    )


def maps_of(result: CubeResult) -> xr.Dataset:
    with result.open() as maps:
        return maps.load()


def run(cube, output: Path, **options) -> xr.Dataset:
    return maps_of(fit_cube(SCENE, cube, FREE, output, standard_uncertainty=SIGMA, **options))


@pytest.mark.parametrize("interleave", ["bil", "bip", "bsq"])
@pytest.mark.parametrize("kind", [np.uint16, np.float32, ">f8"])
def test_a_file_is_read_as_another_package_reads_it(tmp_path: Path, interleave: str, kind) -> None:
    values = np.random.default_rng(1).uniform(0, 60_000, (7, 5, WAVES.size)).astype(kind)
    if interleave == "bil" and kind == ">f8":
        values = values.astype("<f8")
    path = saved(tmp_path / "a.hdr", values, interleave)
    theirs = np.asarray(envi.open(str(path)).load(scale=False), dtype=np.float64)
    array = open_cube(path)
    assert array.dims == ("line", "sample", "wavelength")
    np.testing.assert_array_equal(array.coords["wavelength"], WAVES)
    for part in (
        {},
        {"line": slice(2, 5)},
        {"line": 3},
        {"line": slice(6, 1, -2), "sample": 2},
        {"line": slice(3, 3)},
        {"wavelength": np.array([0, 2, 5])},
    ):
        found = array.isel(part).values
        np.testing.assert_allclose(found, xr.DataArray(theirs, dims=array.dims).isel(part).values, rtol=1e-6)


def test_pixels_are_fitted_as_single_spectra(cube: Path, tmp_path: Path, factors: np.ndarray) -> None:
    maps = run(cube, tmp_path / "out.nc")
    assert (maps["status"] == 0).all()
    assert maps["angle"].attrs["units"] == "degree"
    raw = np.round(factors * 20_000) / 20_000
    template = Measurement(WAVES, np.zeros(1), np.zeros(1), raw[3, 4][None], np.full((1, WAVES.size), SIGMA))
    alone = fit(SCENE, template, FREE, tolerance=1e-6)
    for name, scale in (("angle", 180 / np.pi), ("gain", 1.0)):
        one = alone.estimates[name]
        assert float(maps[name][3, 4]) == pytest.approx(scale * one.value, abs=1e-4)
        assert float(maps[f"{name}_standard_error"][3, 4]) == pytest.approx(scale * one.standard_error, rel=1e-2)
    assert float(maps["chi_square"][3, 4]) == pytest.approx(alone.chi_square, rel=1e-4)
    assert int(maps["degrees_of_freedom"][3, 4]) == alone.degrees_of_freedom
    pulls = (maps["angle"].values - np.degrees(_angles())) / maps["angle_standard_error"].values
    assert np.abs(np.median(pulls)) < 0.5
    assert not list(tmp_path.glob("*.part"))


def test_free_spectra_are_maps_of_spectra(tmp_path: Path) -> None:
    matte = vc.Scene(vc.VGrooves(np.radians(60)), vc.Lambertian(np.full(WAVES.size, 0.5)), vc.Diffuse(), vc.View())
    values = np.full((2, 3, WAVES.size), 0.3)
    values[0, 1] = np.nan
    cube = xr.DataArray(values, dims=("line", "sample", "wavelength"), coords={"wavelength": WAVES})
    result = fit_cube(
        matte,
        cube,
        [free.reflectance()],
        tmp_path / "a.nc",
        standard_uncertainty=0.01,
        reflectance_unit="fraction",
    )
    maps = maps_of(result)
    assert maps["reflectance"].dims == ("line", "sample", "wavelength")
    np.testing.assert_array_equal(maps["wavelength"], WAVES)
    again = fit_many(
        matte,
        Measurement(WAVES, np.zeros(1), np.zeros(1), np.full((1, WAVES.size), 0.5)),
        [free.reflectance()],
        spectra=values.reshape(-1, 1, WAVES.size),
        standard_uncertainty=0.01,
    )
    np.testing.assert_allclose(maps["reflectance"][1, 1], again.spectra["reflectance"][4], rtol=1e-9)
    assert STATUSES[int(maps["status"][0, 1])] == "dead"
    result.plot(tmp_path / "a.png")


# -- counts to reflectance ------------------------------------------------------------------------


@pytest.fixture
def camera(tmp_path: Path, factors: np.ndarray):
    """Counts with an uneven light and an offset, and both references as files of a few lines."""
    random = np.random.default_rng(2)
    dark = random.uniform(90, 110, (10, WAVES.size))
    light = random.uniform(20_000, 30_000, (10, WAVES.size))
    counts = saved(tmp_path / "counts.hdr", (dark + light * factors).astype(np.float32))
    bright = np.stack([dark + 0.99 * light] * 3).astype(np.float32)
    return (
        counts,
        saved(tmp_path / "white.hdr", bright, "bsq"),
        saved(tmp_path / "dark.hdr", np.stack([dark] * 2).astype(np.float32)),
    )


def test_references_undo_light_and_offset(camera, tmp_path: Path, factors: np.ndarray) -> None:
    counts, white, dark = camera
    maps = run(counts, tmp_path / "a.nc", white=white, dark=dark, white_reflectance=0.99)
    flat = xr.DataArray(factors, dims=("line", "sample", "wavelength"), coords={"wavelength": WAVES})
    wanted = run(flat, tmp_path / "b.nc", reflectance_unit="fraction")
    np.testing.assert_allclose(maps["angle"], wanted["angle"], atol=1e-3)
    np.testing.assert_allclose(maps["gain"], wanted["gain"], atol=1e-5)


def test_a_region_of_the_cube_is_a_reference(tmp_path: Path, factors: np.ndarray) -> None:
    values = np.concatenate(
        [factors * 5000 + 100, np.full((2, 10, WAVES.size), 5100.0), np.full((1, 10, WAVES.size), 100.0)]
    )
    cube = saved(tmp_path / "a.hdr", values)
    maps = run(cube, tmp_path / "a.nc", white=(slice(12, 14), slice(0, 10)), dark=(slice(14, 15), slice(2, 8)))
    flat = xr.DataArray(factors, dims=("line", "sample", "wavelength"), coords={"wavelength": WAVES})
    wanted = run(flat, tmp_path / "b.nc", reflectance_unit="fraction")
    np.testing.assert_allclose(maps["angle"][:12], wanted["angle"], atol=1e-6)


def test_dead_saturated_and_bad_are_left_out_and_told(tmp_path: Path, factors: np.ndarray) -> None:
    values = np.round(factors * 20_000).astype(np.uint16)
    values[0, 0] = 65_535  # saturated in all bands
    values[1, 1, :2] = 65_535  # in two
    values[2, 2] = 7  # nothing was stored
    values[3, 3, 0] = 7
    white = np.full((10, WAVES.size), 20_000.0)
    white[5] = 0.0  # a dead element of the detector
    white[6, 3] = 0.0
    cube = saved(tmp_path / "a.hdr", values, data_ignore_value="7", bbl=["1"] * (WAVES.size - 1) + ["0"])
    scene = vc.Scene(SCENE.surface, vc.Specular(GOLD[:-1]), SCENE.illumination, SCENE.view)
    result = fit_cube(
        scene, cube, FREE, tmp_path / "a.nc", standard_uncertainty=SIGMA, white=white, saturation=65_535.0
    )
    maps = maps_of(result)
    status = np.array(STATUSES)[maps["status"].values]
    assert status[0, 0] == "saturated"
    assert status[2, 2] == "dead"
    assert (status[np.arange(12) != 0, 5] == "dead").all()
    assert int(maps["missing_bands"][1, 1]) == 2
    assert int(maps["missing_bands"][3, 3]) == 1
    assert (maps["missing_bands"].values[:, 6] == 1).all()
    assert status[1, 1] == status[3, 3] == status[4, 6] == "converged"
    assert maps["wavelength"].size == WAVES.size - 1
    counts = result.counts()
    assert (counts["saturated"], counts["dead"], sum(counts.values())) == (1, 13, 120)
    assert counts["converged"] > 100
    assert "1 saturated, 13 dead" in result.summary()
    result.plot(tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 10_000


# -- faults ---------------------------------------------------------------------------------------


def refusal(*args, **options) -> str:
    with pytest.raises((ValueError, OSError)) as caught:
        fit_cube(SCENE, *args, **{"standard_uncertainty": SIGMA} | options)
    said = str(caught.value)
    assert "\n" not in said
    return said


def test_bad_files_are_named(cube: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.nc"
    header, raw = cube.read_text(), cube.with_suffix(".raw")
    good = raw.read_bytes()

    def with_header(old: str, new: str) -> str:
        assert old in header
        cube.write_text(header.replace(old, new))
        return refusal(cube, FREE, output).replace(str(tmp_path), "DIR")

    longer = with_header("bands = 8", "bands = 9")
    assert "DIR/gold.raw: holds 1920 bytes, 10 whole lines; expected 2160, for the 12 lines" in longer
    assert "lines is 'x'; expected a whole number" in with_header("lines = 12", "lines = x")
    assert "interleave is 'bix'" in with_header("interleave = bil", "interleave = bix")
    assert "data type is '6'" in with_header("data type = 12", "data type = 6")
    assert "wavelength units is 'furlongs'" in with_header("Nanometers", "furlongs")
    assert "wavelength 2 is 42 nm; expected increasing" in with_header("460.0", "42")
    assert "no wavelength; expected a list" in with_header("wavelength = ", "wavelengths = ")
    assert "reflectance scale factor is 'x'" in with_header("factor = 20000", "factor = x")
    assert "not an ENVI header" in with_header("ENVI", "INVI")
    cube.write_text(header)
    raw.write_bytes(good[:-161])
    assert "gold.raw: holds 1759 bytes, 10 whole lines; expected 1920, for the 12 lines" in refusal(
        cube, FREE, output
    )
    raw.unlink()
    assert "no data file beside it; expected gold.raw" in refusal(cube, FREE, output)
    assert "nothing.hdr: no such file" in refusal(tmp_path / "nothing.hdr", FREE, output)
    assert "is a directory" in refusal(tmp_path, FREE, output)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["gold.hdr"]


def test_more_bands_than_the_file_holds(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.hdr", np.ones((4, 3, WAVES.size), np.float32), "bsq")
    text = path.read_text().replace("bands = 8", "bands = 9").replace("700.0", "700.0, 740.0")
    path.write_text(text)
    assert "holds 384 bytes, 8 whole bands; expected 432" in refusal(path, FREE, tmp_path / "out.nc")


def test_bad_references_are_named(camera, cube: Path, tmp_path: Path) -> None:
    counts, white, dark = camera
    output = tmp_path / "out.nc"
    assert "counts or reflectances? expected white=" in refusal(counts, FREE, output)
    assert "absent.hdr: no such file" in refusal(counts, FREE, output, white=tmp_path / "absent.hdr")
    assert "a dark reference without a white one" in refusal(counts, FREE, output, dark=dark)
    assert "nowhere brighter than the dark one" in refusal(counts, FREE, output, white=dark, dark=white)
    assert "reflectance_unit beside a white reference" in refusal(
        counts, FREE, output, white=white, reflectance_unit="percent"
    )
    assert "the region of the white reference is empty" in refusal(
        counts, FREE, output, white=(slice(50, 60), slice(0, 2))
    )
    assert "has the shape (3,); expected" in refusal(counts, FREE, output, white=np.ones(3))
    assert "white reference is saturated" in refusal(counts, FREE, output, white=white, saturation=10.0)
    assert "white_reflectance: expected one fraction" in refusal(
        counts, FREE, output, white=white, white_reflectance=99.0
    )
    assert "expected no reflectance_unit beside it" in refusal(cube, FREE, output, reflectance_unit="percent")
    assert "these look like percent or counts" in refusal(counts, FREE, output, reflectance_unit="fraction")
    narrow = saved(tmp_path / "narrow.hdr", np.ones((1, 4, WAVES.size), np.float32))
    assert "4 samples and 8 bands; expected 10 and 8" in refusal(counts, FREE, output, white=narrow)
    assert not list(tmp_path.glob("out.nc*"))


def test_bad_requests_are_named(cube: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.nc"
    assert "expected a name that ends in .nc" in refusal(cube, FREE, tmp_path / "out.png")
    assert "workers is 0" in refusal(cube, FREE, output, workers=0)
    assert "standard_uncertainty: expected a number above 0" in refusal(
        cube, FREE, output, standard_uncertainty=0.0
    )
    assert "no good band lies within 900 to 950 nm" in refusal(cube, FREE, output, wavelengths_nm=(900.0, 950.0))
    many = vc.Scene(SCENE.surface, SCENE.material, SCENE.illumination, vc.View(np.zeros(3), np.zeros(3)))
    with pytest.raises(ValueError, match="seen from 3 directions; expected one"):
        fit_cube(many, cube, FREE, output, standard_uncertainty=SIGMA)
    plain = xr.DataArray(np.ones((2, 2)), dims=("x", "y"))
    assert "the cube has the dimensions x, y; expected line, sample and wavelength" in refusal(plain, FREE, output)


# -- resumed, and spread --------------------------------------------------------------------------


def test_an_unfinished_fit_of_something_else_is_not_taken(cube: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("fitting.cubes.fit._VALUES_AT_ONCE", 10 * WAVES.size)
    output = tmp_path / "out.nc"

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("fitting.cubes.fit.write_maps", stop)
    with pytest.raises(KeyboardInterrupt):
        run(cube, output)
    assert len(list((tmp_path / "out.nc.part").glob("*.npz"))) == 12
    monkeypatch.undo()
    monkeypatch.setattr("fitting.cubes.fit._VALUES_AT_ONCE", 10 * WAVES.size)
    assert "holds an unfinished fit of something else" in refusal(cube, FREE, output, standard_uncertainty=0.01)
    monkeypatch.setattr("fitting.cubes.blocks.Job.run", stop)  # Nothing is left to be fitted.
    assert (run(cube, output)["status"] == 0).all()


def test_a_folder_that_a_kill_left_empty_is_taken(cube: Path, tmp_path: Path) -> None:
    (tmp_path / "out.nc.part").mkdir()
    assert (run(cube, tmp_path / "out.nc")["status"] == 0).all()
    assert not (tmp_path / "out.nc.part").exists()


def test_other_arrays_are_told_apart(cube: Path, factors: np.ndarray) -> None:
    """By their lines, whatever their attribute "source" says."""
    array = xr.DataArray(factors, dims=("line", "sample", "wavelength"), coords={"wavelength": WAVES})
    known = stamp(array)
    assert known == stamp(array.assign_attrs(source=str(cube.parent / "a.nc")))
    changed = array.copy()
    changed[7, 3, 2] += 0.1
    assert stamp(changed) != known
    assert stamp(open_cube(cube)) == (
        cube.with_suffix(".raw").stat().st_size,
        cube.with_suffix(".raw").stat().st_mtime_ns,
    )


SCRIPT = """
import sys, jax
jax.config.update("jax_enable_x64", True)
import numpy as np, vcavity_jax as vc, fitting.cubes.fit as module
from fitting import free
from fitting.cubes import fit_cube
module._VALUES_AT_ONCE = 10 * 8
waves = np.arange(420.0, 701.0, 40.0)
gold = vc.Specular(vc.materials.refractive_index("Au-Johnson", waves))
scene = vc.Scene(vc.VGrooves(1.0), gold, vc.Diffuse(), vc.View())
fit_cube(scene, sys.argv[1], [free.angle(30, 110), free.gain()], sys.argv[2], standard_uncertainty=0.004)
"""


def test_a_killed_run_resumes_and_ends_with_the_same_maps(cube: Path, tmp_path: Path) -> None:
    output = tmp_path / "killed.nc"
    argv = [sys.executable, "-c", SCRIPT, str(cube), str(output)]
    part = tmp_path / "killed.nc.part"
    process = subprocess.Popen(argv)
    deadline = time.monotonic() + 120
    while len(list(part.glob("*.npz"))) < 3 and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = {path.name: path.stat().st_mtime_ns for path in part.glob("lines*.npz")}
    assert 3 <= len(kept) <= 12
    assert not output.exists()
    subprocess.run(argv, check=True)
    assert not part.exists()
    found, wanted = maps_of(CubeResult(output)), run(cube, tmp_path / "whole.nc")
    for name in wanted.variables:
        np.testing.assert_allclose(found[name].values, wanted[name].values, rtol=1e-12, atol=1e-12, err_msg=name)


def test_two_workers_find_the_same(cube: Path, tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("fitting.cubes.fit._VALUES_AT_ONCE", 3 * 10 * WAVES.size)
    found, wanted = run(cube, tmp_path / "a.nc", workers=2), run(cube, tmp_path / "b.nc")
    for name in wanted.variables:
        np.testing.assert_allclose(found[name].values, wanted[name].values, rtol=1e-6, atol=1e-6, err_msg=name)


def test_workers_need_dask(cube: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert "pip install 'vcavity[dask]'" in refusal(cube, FREE, tmp_path / "a.nc", workers=2)


# -- the command ----------------------------------------------------------------------------------


def test_the_command(cube: Path, camera, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mirror = ["--material", "specular", "--index", "Au-Johnson", "--uncertainty", "0.004"]
    both = ["--free", "angle", "--free", "gain", "--angle-range", "30:110"]
    assert main(["cube", str(cube), *mirror, *both]) == 0
    out = capsys.readouterr().out
    assert "120 pixels: 120 converged" in out
    assert "angle: median 6" in out
    assert f"wrote {tmp_path / 'gold-fit.nc'}\nwrote {tmp_path / 'gold-fit.png'}\n" in out
    counts, white, dark = map(str, camera)
    output = ["--output", str(tmp_path / "b.nc")]
    argv = [
        "cube",
        counts,
        *mirror,
        *both,
        *output,
        "--white",
        white,
        "--dark",
        dark,
        "--white-reflectance",
        "0.99",
    ]
    assert main([*argv, "--band-range", "450:680"]) == 0
    with CubeResult(tmp_path / "b.nc").open() as maps:
        assert maps["wavelength"].size == 6
    capsys.readouterr()
    for wrong, said in (
        (["--white", "9:3,0:1"], "lines and samples"),
        (["--white", "no.hdr"], "no.hdr: no such file"),
        (["--band-range", "900:950"], "--band-range: no good band lies within 900 to 950 nm"),
        (["--reflectance-unit", "percent"], "reflectance scale factor"),
        (["--output", str(tmp_path / "gold.hdr" / "a.nc")], "gold.hdr"),
    ):
        assert main(["cube", str(cube), *mirror, *wrong]) == 2
        err = capsys.readouterr().err
        assert said in err
        assert err.count("\n") == 1
    assert main(["cube", counts, *mirror]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"vcavity: {counts}: counts or reflectances? expected --white (and --dark), ")
    assert said.endswith("or --reflectance-unit fraction or percent\n")
    assert main(["cube", str(cube), "--material", "specular", "--index", "Au-Johnson"]) == 2
    assert "--uncertainty" in capsys.readouterr().err
    os.remove(cube)
    assert main(["cube", str(cube), *mirror]) == 2
    assert capsys.readouterr().err == f"vcavity: {cube}: no such file\n"
