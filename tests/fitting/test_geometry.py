"""The geometries of instruments, from a line in the file to the fitted angle."""

import re
from pathlib import Path

import jax
import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Measurement, fit, free, read_spectrum
from fitting.readers import geometry
from vcavity_jax import geometries

ROWS = "wavelength_nm,reflectance_factor\n450,0.2\n550,0.3\n"
TIDY = "wavelength_nm,polar_deg,azimuth_deg,reflectance_factor\n450,0,0,0.2\n"
BAND = np.array([450.0, 500.0, 550.0, 600.0, 650.0, 700.0])
RED = np.array([0.08, 0.12, 0.3, 0.55, 0.7, 0.75])


def write(folder: Path, text: str) -> Path:
    path = folder / "sample.csv"
    path.write_text(text, encoding="utf-8")
    return path


def assert_same(found, expected) -> None:
    """The same parts of a scene, to the last bit."""
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(np.ravel(one), np.ravel(other))


# What the library says of its geometries.


def test_names_are_those_of_the_library():
    assert geometry.GEOMETRIES == geometries.GEOMETRIES


@pytest.mark.parametrize("name", geometry.GEOMETRIES)
def test_angles_matter_where_they_are_allowed(name):
    def moved(**angle):
        usual, other = (jax.tree.leaves(vc.cie_geometry(name, **change)) for change in ({}, angle))
        return any(float(one) != float(two) for one, two in zip(usual, other, strict=True))

    assert moved(azimuth=1.0) == (name in geometry.TURNED)
    assert moved(trap_half_angle=0.05) == (name in geometry.TRAPPED)


def test_the_widest_trap_is_the_library_s():
    widest = geometry.WIDEST_TRAP_DEG
    assert isinstance(geometry.named("de:8", 0.0, widest - 1e-6).illumination, vc.DiffuseWithTrap)
    with pytest.raises(ValueError, match="16 degrees"):
        geometry.named("de:8", 0.0, widest)


# Files.


@pytest.mark.parametrize("name", geometry.GEOMETRIES)
def test_a_named_geometry_sets_light_and_view(tmp_path, name):
    m = Measurement.read(write(tmp_path, f"# geometry: {name}\n{ROWS}"))
    illumination, view = vc.cie_geometry(name)
    assert_same(m.illumination, illumination)
    assert_same(m.view, view)
    assert m.reflectance_factor.tolist() == [[0.2, 0.3]]
    assert m.hemispherical == name.endswith(":d")
    assert np.isnan([m.polar, m.azimuth]).all() == m.hemispherical
    assert m.metadata["geometry"] == name
    part = m.select(wavelengths_nm=(500.0, 600.0))
    assert part.hemispherical == m.hemispherical
    assert_same(part.view, view)


def test_azimuth_and_trap_of_a_geometry(tmp_path):
    words = "# Geometry: DE:8°\n# geometry_azimuth_deg: -90\n# trap_half_angle_deg: 7.5\n"
    m = Measurement.read(write(tmp_path, words + ROWS))
    illumination, view = vc.cie_geometry("de:8", -np.pi / 2, trap_half_angle=np.deg2rad(7.5))
    assert_same(m.illumination, illumination)
    assert_same(m.view, view)
    assert m.polar.tolist() == [np.deg2rad(8.0)]
    assert m.azimuth.tolist() == [-np.pi / 2]


def test_a_geometry_of_every_form_of_spectrum(tmp_path):
    for rows in ("450,0.2\n550,0.3\n", "wavelength_nm,reflectance\n450,0.2\n550,0.3\n"):
        assert Measurement.read(write(tmp_path, rows + "# geometry: 8°:d\n")).hemispherical
    path = write(tmp_path, "# geometry: d:d\nwavelength_nm,a,b\n450,0.2,0.4\n550,,0.5\n")
    assert Measurement.read(path, column="b").reflectance_factor.tolist() == [[0.4, 0.5]]
    gappy = Measurement.read(path, column="a")
    assert gappy.hemispherical
    assert np.isnan(gappy.reflectance_factor[0, 1])
    # A flat sample reads the same in all of them.
    assert read_spectrum(path, column="b")[1].tolist() == [0.4, 0.5]


def test_a_ring_of_light(tmp_path):
    path = write(tmp_path, "# illumination: Annular, polar_deg = 45\n" + TIDY + "450,30,0,0.1\n")
    m = Measurement.read(path)
    assert_same(m.illumination, vc.Annular(np.deg2rad(45.0)))
    assert m.polar.tolist() == [0, np.deg2rad(30.0)]
    assert not m.hemispherical


CONFLICT = "d:8 in line 1"
BAD = {
    "unknown": ("\n# geometry: 45/0\n" + ROWS, ":2: geometry '45/0' is unknown", "d:0, d:8, di:8, de:8, d:d"),
    "slash": ("# geometry: d/8°\n" + ROWS, ":1: geometry 'd/8°' is unknown (did you mean 'd:8'?)"),
    "empty": ("# geometry:\n" + ROWS, ":1: geometry '' is unknown; expected one of d:0"),
    "light too": (
        "# geometry: d:8\n# illumination: diffuse\n" + ROWS,
        f":2: illumination beside geometry {CONFLICT}; expected one of them",
    ),
    "columns too": (
        "# geometry: d:8\n" + TIDY,
        f":2: column 'polar_deg' beside geometry {CONFLICT}, which sets the view; expected one of them",
        "geometry_azimuth_deg",
    ),
    "columns before": (TIDY + "# geometry: d:d\n", ":1: column 'polar_deg' beside geometry d:d in line 3"),
    "polar too": ("# geometry: d:8\n# polar_deg: 8\n" + ROWS, f":2: polar_deg beside geometry {CONFLICT}"),
    "azimuth too": (
        "# geometry: d:8\n# azimuth_deg: 90\n" + ROWS,
        f":2: azimuth_deg beside geometry {CONFLICT}",
        "write '# geometry_azimuth_deg: 90'",
    ),
    "azimuth alone": ("# geometry_azimuth_deg: 90\n" + ROWS, ":1: geometry_azimuth_deg without a geometry"),
    "trap alone": (ROWS + "# trap_half_angle_deg: 6\n", ":4: trap_half_angle_deg without a geometry"),
    "no azimuth": (
        "# geometry: d:0\n# geometry_azimuth_deg: 90\n" + ROWS,
        ":2: geometry_azimuth_deg has no effect in d:0; expected it with d:8, di:8, de:8, 8:d, 45x:0 only",
    ),
    "no trap": (
        "# geometry: di:8\n# trap_half_angle_deg: 6\n" + ROWS,
        ":2: trap_half_angle_deg has no effect in di:8; expected it with de:8 only",
    ),
    "azimuth words": (
        "# geometry: d:8\n# geometry_azimuth_deg: along\n" + ROWS,
        ":2: geometry_azimuth_deg is 'along'; expected -360 to 360 degrees",
    ),
    "azimuth nan": ("# geometry: d:8\n# geometry_azimuth_deg: nan\n" + ROWS, ":2: geometry_azimuth_deg is 'nan'"),
    "wide trap": (
        "# geometry: de:8\n# trap_half_angle_deg: 16\n" + ROWS,
        ":2: trap_half_angle_deg is '16'; expected 0 to less than 16 degrees",
    ),
    "negative trap": ("# geometry: de:8\n# trap_half_angle_deg: -1\n" + ROWS, ":2: trap_half_angle_deg is '-1'"),
    "twice": ("# geometry: d:8\n# geometry: d:8\n" + ROWS, ":2: metadata 'geometry' is given twice"),
    "equals sign": ("# geometry = d:8\n" + ROWS, ":1: metadata 'geometry' is written with '='"),
    "misspelled": ("# geometry: de:8\n# trap_halfangle_deg: 5\n" + ROWS, ":2: unknown metadata 'trap_halfangle_"),
    "ring from below": ("# illumination: annular, polar_deg=-45\n" + ROWS, ":1: illumination is 'annular, "),
    "ring aside": ("# illumination: annular, polar_deg=45, azimuth_deg=0\n" + ROWS, "or 'annular, polar_deg=45'"),
    "ring without angle": ("# illumination: annular\n" + ROWS, ":1: illumination is 'annular'; expected"),
    "diffuse angle": ("# illumination: diffuse, polar_deg=45\n" + ROWS, ":1: illumination is 'diffuse, polar"),
    "angle twice": ("# illumination: directional, polar_deg=4, polar_deg=5\n" + ROWS, ":1: illumination is"),
}


@pytest.mark.parametrize(("text", "fragments"), [(b[0], b[1:]) for b in BAD.values()], ids=BAD)
def test_a_bad_geometry_is_refused_with_its_line(tmp_path, text, fragments):
    path = write(tmp_path, text)
    with pytest.raises(ValueError, match=re.escape(str(path))) as caught:
        Measurement.read(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:")
    assert "\n" not in message
    for fragment in fragments:
        assert fragment in message


# The object.


def hemispherical(values, sigma=None, light=None) -> Measurement:
    values = np.atleast_2d(values)
    uncertainty = None if sigma is None else np.full(values.shape, sigma)
    nothing = np.array([np.nan])
    return Measurement(
        BAND[: values.size], nothing, nothing, values, uncertainty, illumination=light, hemispherical=True
    )


def test_what_collects_all_light_has_no_direction():
    m = hemispherical([0.1, 0.2])
    assert isinstance(m.view, vc.Hemisphere)
    with pytest.raises(ValueError, match=r"polar\[0\] is 0; expected NaN: what collects all light"):
        Measurement(BAND[:1], np.zeros(1), np.zeros(1), np.ones((1, 1)), hemispherical=True)
    with pytest.raises(ValueError, match="nan is not a polar angle"):
        vc.View(m.polar, m.azimuth)  # type: ignore[arg-type]


def test_light_from_the_hemisphere_is_diffuse():
    assert isinstance(hemispherical([0.1], light=vc.Hemisphere()).illumination, vc.Diffuse)


# Fits.


def gold() -> vc.Specular:
    return vc.Specular(vc.materials.refractive_index("Au-Johnson", BAND))


def measured(name, surface, material, sigma=0.003, seed=None, **angles) -> tuple[vc.Scene, Measurement]:
    """Values of the model in a geometry, with noise of the stated uncertainty if a seed is given."""
    illumination, view = vc.cie_geometry(name, **angles)
    scene = vc.Scene(surface, material, illumination, view)
    values = np.broadcast_to(vc.reflectance_factor(scene), BAND.shape)[None]
    if seed is not None:
        values = values + sigma * np.random.default_rng(seed).standard_normal(values.shape)
    if isinstance(view, vc.Hemisphere):
        return scene, hemispherical(values, sigma, illumination)
    polar, azimuth = np.atleast_1d(view.polar), np.atleast_1d(view.azimuth)
    return scene, Measurement(BAND, polar, azimuth, values, np.full(values.shape, sigma), illumination)


GOLD_60, MATTE_75 = vc.VGrooves(np.radians(60.0)), vc.VGrooves(np.radians(75.0))
FITS = [
    ("d:d", GOLD_60, "gold", 1.0),
    ("d:8", GOLD_60, "gold", 1.0),
    ("8:d", GOLD_60, "gold", 1.0),
    ("de:8", GOLD_60, "gold", 1.0),
    ("d:d", MATTE_75, "matte", 1.0),
    ("45a:0", MATTE_75, "matte", 1.0),
    ("45x:0", MATTE_75, "matte", 1.0),
    pytest.param("d:d", vc.BeckmannGrooves(0.5), "gold", 0.03, marks=pytest.mark.slow),
    pytest.param("d:8", vc.GaussianGrooves(0.5), "gold", 0.03, marks=pytest.mark.slow),
    ("0:d", vc.GaussianGrooves(0.5), "matte", 0.03),
]


@pytest.mark.parametrize(("name", "surface", "material", "widest"), FITS)
def test_a_surface_is_recovered_in_its_geometry(name, surface, material, widest):
    """Within four standard errors; these are at most a degree, or 0.03 in roughness, at a noise of 0.003."""
    panels = gold() if material == "gold" else vc.Lambertian(RED)
    scene, m = measured(name, surface, panels, seed=11)
    parameter = free.angle(25, 150) if isinstance(surface, vc.VGrooves) else free.roughness(0.2, 1)
    result = fit(scene, m, [parameter], tolerance=1e-5)
    (estimate,) = result.estimates.values()
    truth = float(jax.tree.leaves(surface)[0])
    assert result.status == "converged"
    assert estimate.displayed(estimate.standard_error) < widest
    assert abs(estimate.value - truth) < 4 * estimate.standard_error
    assert result.predicted.shape == m.reflectance_factor.shape
    assert result.to_dict()["scene"]["view"]["type"] == ("Hemisphere" if name.endswith(":d") else "View")


def test_both_ways_through_an_instrument_fit_alike():
    """Helmholtz: the same values measured as d:8 and as 8:d, the sample turned."""
    turned = np.radians(50.0)
    scene, m = measured("d:8", GOLD_60, gold(), seed=3, azimuth=turned)
    light, view = vc.cie_geometry("8:d", turned)
    back = hemispherical(m.reflectance_factor, 0.003, light)
    one = fit(scene, m, [free.angle(40, 80)])
    other = fit(vc.Scene(GOLD_60, gold(), light, view), back, [free.angle(40, 80)])
    assert other.estimates["angle"].value == pytest.approx(one.estimates["angle"].value, abs=1e-6)
    assert other.chi_square == pytest.approx(one.chi_square, rel=1e-6)


def test_a_gray_material_and_a_gap():
    scene, m = measured("d:d", vc.VGrooves(np.radians(60.0)), vc.Lambertian(0.5))
    values = m.reflectance_factor.copy()
    values[0, 2] = np.nan
    result = fit(scene, hemispherical(values, 0.003), [free.angle(30, 120), free.gain()], tolerance=1e-6)
    assert np.degrees(result.estimates["angle"].value) == pytest.approx(60, abs=1e-3)
    assert np.isnan(result.residuals).tolist() == [[False, False, True, False, False, False]]
    short = vc.Scene(scene.surface, vc.Lambertian(RED[:4]), scene.illumination, scene.view)
    with pytest.raises(ValueError, match=r"wavelength shape \(4,\), the measurement 6 wavelengths"):
        fit(short, m, [free.angle()])


def test_the_light_of_scene_and_measurement_must_agree():
    m = Measurement(BAND, np.zeros(1), np.zeros(1), RED[None], illumination=vc.Annular(np.pi / 4))
    lit = vc.Scene(vc.VGrooves(1.0), vc.Lambertian(RED), vc.Annular(0.5), vc.View())
    with pytest.raises(ValueError, match=r"lit by Annular\(0.5\), the measurement by Annular\(0.785398\)"):
        fit(lit, m, [free.angle()])


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("d:d", "measure in single directions, as in d:8"),
        pytest.param("0:d", "add directions of the light (as views in diffuse light, by reciprocity)"),
        ("d:0", "add directions"),
    ],
)
def test_advice_fits_the_geometry(name, advice):
    scene, m = measured(name, vc.VGrooves(1.0), vc.Lambertian(np.zeros(6)))
    result = fit(scene, m, [free.angle(60, 120)], tolerance=1e-4)
    assert result.status == "not identifiable"
    assert f"range: {advice}, fix another" in result.message
    assert f"no standard error; {advice}, widen" in " ".join(result.warnings)
    assert "along the grooves" not in " ".join(result.warnings)


@pytest.mark.parametrize(("name", "where"), [("d:d", "in diffuse light"), ("0:d", "with all its light collected")])
def test_more_light_than_arrives(name, where):
    scene, m = measured(name, vc.VGrooves(2.0), vc.Lambertian(RED))
    values = m.reflectance_factor.copy()
    values[0, 5] = 1.1
    bad = hemispherical(values, 0.003, m.illumination)
    assert f"no surface does that {where}" in " ".join(fit(scene, bad, [free.angle(60, 170)]).warnings)


def test_a_mirror_lit_near_the_normal_is_blind_both_ways():
    scene, m = measured("8:d", vc.VGrooves(np.radians(150.0)), gold())
    assert "blind" in " ".join(fit(scene, m, [free.angle(125, 175)]).warnings)
