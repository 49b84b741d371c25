"""The benchmark: its peers are right by themselves, its rows are sound, and what it writes is whole."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc
from fitting.bench import mirrors, nystrom, path_tracer, report, thesis_recipe
from fitting.bench.measure import Effort, Peer, Quantity, rows
from fitting.bench.peak import measure_peak
from fitting.bench.timing import compiled, median_time
from fitting.cli import arguments, main

R = np.array([0.2, 0.6, 0.95])
OBLIQUE = (0.7, 0.4)


def ours(angle, material, view):
    detector = vc.Hemisphere() if view is None else vc.View(*view)
    return np.asarray(vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), material, vc.Diffuse(), detector), 1e-6))


@pytest.mark.parametrize("view", [(0.0, 0.0), OBLIQUE, None])
def test_the_path_tracer_agrees(view):
    """Within five standard deviations of 40 000 paths, which are at most 0.5 each."""
    paths, random = 40_000, np.random.default_rng(3)
    allowed = 5 * 0.5 / np.sqrt(paths)
    for angle in (0.8, 1.9):
        diffusing = path_tracer.diffusing(angle, R, view, paths, random)
        np.testing.assert_allclose(diffusing, ours(angle, vc.Lambertian(R), view), atol=allowed)
        below = path_tracer.diffusing(angle, R, view, paths, random, 1.5)
        np.testing.assert_allclose(below, ours(angle, vc.InterfacedLambertian(R, 1.5), view), atol=allowed)
        index = np.array([0.3 + 2.6j, 4 + 0.03j, 1.5 + 0j])
        traced = path_tracer.mirrors(angle, index, view, paths // 4, random)
        np.testing.assert_allclose(traced, ours(angle, vc.Specular(index), view), atol=2 * allowed)


def test_the_path_tracer_follows_random_grooves():
    random = np.random.default_rng(4)
    angle = 2 * np.arctan2(1.0, 0.5 * np.sqrt(-2 * np.log(random.uniform(size=40_000))))
    traced = path_tracer.diffusing(angle, R, (0.0, 0.0), 40_000, random)
    scene = vc.Scene(vc.BeckmannGrooves(0.5), vc.Lambertian(R), vc.Diffuse(), vc.View())
    np.testing.assert_allclose(traced, vc.reflectance_factor(scene, 1e-6), atol=0.0125)


@pytest.mark.parametrize("diffuse", [True, False])
def test_the_dense_solve_converges(diffuse):
    light = vc.Diffuse() if diffuse else vc.Directional()
    exact = vc.reflectance_factor(vc.Scene(vc.VGrooves(1.2), vc.Lambertian(R), light, vc.View()), 1e-12)
    errors = [np.abs(nystrom.open_groove(1.2, R, diffuse, n) - exact).max() for n in (8, 16, 32, 64)]
    assert errors[0] > 10 * errors[1] > 100 * errors[2]
    assert errors[3] < 1e-10


def test_the_recipe_converges_too():
    for light, view in ((None, (0.0, 0.0)), (None, None), ((0.0, 0.0), (0.0, 0.0))):
        exact = thesis_recipe.lambertian(1.2, R, light, view, 256)
        coarse = thesis_recipe.lambertian(1.2, R, light, view, 32)
        detector = vc.Hemisphere() if view is None else vc.View(*view)
        source = vc.Diffuse() if light is None else vc.Directional(*light)
        truth = vc.reflectance_factor(vc.Scene(vc.VGrooves(1.2), vc.Lambertian(R), source, detector), 1e-9)
        assert np.abs(exact - truth).max() < 0.3 * np.abs(coarse - truth).max() < 2e-3


@pytest.fixture(scope="module")
def quantity() -> Quantity:
    """The frontal mirror, and peers that are quick, or wrong."""
    one = mirrors.QUANTITIES[0]
    wrong = Peer("wrong by 0.01", lambda angle: one.exact(angle) + 0.01)
    return dataclasses.replace(one, peers=(wrong,))


@pytest.fixture(scope="module")
def machines():
    return report.find_machines()[0]


@pytest.fixture(scope="module")
def found(quantity, machines):
    return list(rows(quantity, Effort(batches=(4,), seconds=0.0), machines))


def test_rows_are_sound(found):
    value, gradient, wrong = found
    assert (value.method, value.what, value.scenes, value.device) == ("vcavity", "value", 4, "cpu")
    assert value.error < 1e-13
    assert value.success == 1
    assert value.time_us > 0
    assert value.compile_s > 0
    assert gradient.what == "gradient"
    assert gradient.error < 1e-8
    assert gradient.success == 1
    assert wrong.error == pytest.approx(0.01)
    assert not wrong.compile_s
    assert 0 < value.of_peak < 1
    assert 0 < gradient.of_peak < 1
    assert wrong.of_peak is None


def test_of_the_peak():
    """A program that does nothing but what the peak counts comes near it; so does one that loops."""
    peak = measure_peak()
    x = jnp.linspace(1.0, 2.0, 1 << 15)

    def logarithms(x):
        return jnp.log(x.reshape(16, -1)).sum(axis=0)

    once, _ = compiled(logarithms, x)
    assert 0.1 < peak.fraction(once, 1, median_time(lambda: once(x), 0.1, 200)) < 10
    many, _ = compiled(lambda x: jax.lax.map(logarithms, jnp.broadcast_to(x, (8, x.size))), x)
    assert 0.1 < peak.fraction(many, 1, median_time(lambda: many(x), 0.1, 200) / 8) < 10


def test_a_table_of_two_devices(found):
    both = [*found, dataclasses.replace(found[0], device="gpu", time_us=0.5)]
    text = report.markdown(both, {})
    assert text.count("| gpu |") == 1
    assert float(text.splitlines()[-2].split("|")[-2]) == pytest.approx(found[2].time_us / 0.5, rel=1e-2)
    labels = [t.get_text() for t in report.draw(both).legends[0].get_texts()]
    assert labels == ["vcavity, batch of 4", "vcavity, batch of 4, gpu", "wrong by 0.01"]


def test_the_table_and_the_figure(found, tmp_path):
    machine = {"hardware": "a slide rule"}
    text = report.markdown(found, machine)
    assert "- hardware: a slide rule" in text
    last = text.splitlines()[-1]
    assert last.startswith("| mirrors | gold, diffuse light, frontal view | wrong by 0.01 |")
    assert float(last.split("|")[-2]) == pytest.approx(found[2].time_us / found[0].time_us, rel=1e-2)
    paths = report.write(found, machine, tmp_path / "new")
    assert [path.name for path in paths] == ["bench.json", "bench.md", "bench.png"]
    stored = json.loads(paths[0].read_text())
    assert stored["machine"] == machine
    assert len(stored["rows"]) == 3
    assert paths[2].stat().st_size > 10_000


def test_every_part_has_its_quantities():
    assert tuple(report.PARTS) == arguments.PARTS
    for part in report.PARTS:
        assert {q.part for q in report.quantities([part])} == {part}
    names = [(q.part, q.name) for q in report.quantities(report.PARTS)]
    assert len(set(names)) == len(names) == 15


def test_the_command(quantity, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(report, "quantities", lambda parts: [quantity] if tuple(parts) == ("mirrors",) else [])
    monkeypatch.setattr("fitting.cli.bench.Effort", lambda: Effort(batches=(4,), seconds=0.0))
    assert main(["bench", "--part", "mirrors", "--output", str(tmp_path / "bench")]) == 0
    out, err = capsys.readouterr()
    assert "| mirrors | gold, diffuse light, frontal view | vcavity |" in out
    assert f"wrote {tmp_path / 'bench' / 'bench.json'}" in out
    assert err.count("mirrors: gold") == 3
    assert main(["bench", "--part", "mirror"]) == 2
    assert "invalid choice: 'mirror'" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert main(["bench", "--output", str(tmp_path / "file" / "bench")]) == 2
    assert str(tmp_path / "file") in capsys.readouterr().err


def test_a_peer_that_is_not_installed(quantity, monkeypatch, capsys):
    monkeypatch.setattr(report, "quantities", lambda parts: [quantity])
    monkeypatch.setitem(__import__("sys").modules, "mitsuba", None)
    assert main(["bench", "--peer", "mitsuba"]) == 2
    assert capsys.readouterr().err == (
        "vcavity: --peer mitsuba: not installed; expected the package mitsuba (pip install mitsuba)\n"
    )
