"""`vcavity plan`: what it prints, writes and refuses."""

import json
from pathlib import Path

import numpy as np
import pytest

import vcavity_jax as vc
from fitting import free, plan_views
from fitting.cli import BAD_INPUT, NO_ANSWER, main, words

FLAT = str(Path(__file__).parents[2] / "examples" / "data" / "flat-orange.csv")
MATTE = ["plan", "--material", "lambertian", "--reflectance"]
USUAL = ["--angle", "60deg", "--noise", "0.005", "--wavelengths", "450,550,650", "--count", "2"]
UNKNOWN = ["--free", "angle", "--free", "reflectance"]


def refusal(capsys, *argv):
    assert main(argv) == BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err.removeprefix("vcavity: ").rstrip("\n")


def test_plan_has_help(capsys):
    assert main(["plan", "--help"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("usage: vcavity plan")
    assert "--measured POLAR,AZIMUTH" in out
    assert "(default: 3 degrees, or 1 % of the range of a roughness)" in " ".join(out.split())


def test_plan_prints_and_writes(capsys, tmp_path):
    folder = tmp_path / "next"
    assert main([*MATTE, FLAT, *USUAL, *UNKNOWN, "--spread", "3deg", "--output", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "80 deg" in out
    assert "planned for angle 60 ± 3 deg" in out
    assert "every parameter is identifiable" in out
    written = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    assert {view["polar_deg"] for view in written["views"]} == {0.0, 80.0}
    # Along the normal there is one candidate, not one for each azimuth.
    assert len(written["candidates"]) == 3 * 17 - 2
    assert len((folder / "plan.csv").read_text().splitlines()) == 4
    assert (folder / "plan.png").read_bytes().startswith(b"\x89PNG")
    assert out.count("wrote ") == 3


def test_plan_is_that_of_the_library(capsys):
    argv = [
        *MATTE,
        "0.4",
        *USUAL,
        "--polar",
        "0:80:20",
        "--azimuth",
        "0",
        "--json",
        "--measured",
        "10",
        "--free",
        "angle",
    ]
    assert main([*argv, "--free", "gain", "--criterion", "D", "--interest", "angle", "--interest", "gain"]) == 0
    printed = json.loads(capsys.readouterr().out)
    band = np.array([450.0, 550.0, 650.0])
    scene = vc.Scene(vc.VGrooves(np.radians(60)), vc.Lambertian(np.full(3, 0.4)), vc.Diffuse(), vc.View())
    plan = plan_views(
        scene,
        [free.angle(), free.gain()],
        vc.View(np.radians([0.0, 20, 40, 60, 80]), 0.0),
        2,
        0.005,
        measured=vc.View(np.radians(10.0)),
        criterion="D",
        interest=["angle", "gain"],
        wavelengths_nm=band,
    )
    assert printed["chosen"] == list(plan.chosen)
    assert printed["criterion_values"] == pytest.approx(plan.criterion_values.tolist())
    assert printed["parameters"]["angle"]["standard_error"] == pytest.approx(
        np.degrees(plan.standard_errors["angle"]).tolist()
    )


def test_an_assumed_gray_is_told(capsys):
    gray = [*MATTE[:-1], *USUAL, *UNKNOWN]
    assert main(gray) == 0
    assert "reflectance: a gray of 0.5 is assumed" in capsys.readouterr().out
    assert main([*MATTE, FLAT, *USUAL, *UNKNOWN]) == 0
    assert "assumed" not in capsys.readouterr().out


def test_plan_without_an_answer_has_status_1(capsys):
    assert main([*MATTE, "0.4", *USUAL, *UNKNOWN, "--polar", "0,10,20", "--azimuth", "0"]) == NO_ANSWER
    out, err = capsys.readouterr()
    assert "not identifiable" in out
    assert err.startswith("vcavity: not identifiable after these views: angle")
    assert "not even all candidates" in err


def test_plan_chooses_the_light(capsys):
    lights = ["--illumination", "diffuse", "--illumination", "directional:45,0"]
    assert main([*MATTE, "0.4", *USUAL, *UNKNOWN, *lights, "--polar", "0,8", "--azimuth", "0", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {view["light"] for view in printed["candidates"]} == {"diffuse", "directional:45,0"}
    assert "directional:45,0" in {view["light"] for view in printed["views"]}


def test_plan_of_random_grooves(capsys):
    argv = [
        "plan",
        "--surface",
        "beckmann",
        "--roughness",
        "0.5",
        "--spread",
        "0.1",
        *MATTE[1:],
        "0.4",
        *USUAL[2:],
    ]
    assert main([*argv, "--polar", "0,40,80", "--azimuth", "0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["parameters"]["roughness"]["spread"] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        ([*MATTE, "0.4", *USUAL[2:]], "needs --angle"),
        ([*MATTE, "0.4", *USUAL, "--count", "500"], "count is 500; expected a whole number from 1 to 49"),
        ([*MATTE, "0.4", *USUAL, "--count", "0"], "expected a whole number of at least 1"),
        ([*MATTE, "0.4", *USUAL, "--polar", "0:90:10"], "expected view angles from -89 to 89 degrees"),
        ([*MATTE, "0.4", *USUAL, "--polar", "0:80:7"], "expected a step that leads from 0 to 80"),
        ([*MATTE, "0.4", *USUAL, "--measured", "95,0"], "less than 90 degrees from the normal"),
        ([*MATTE, "0.4", *USUAL, "--noise", "0"], "expected a number above 0"),
        ([*MATTE, "0.4", *USUAL, "--spread", "wide"], "'wide': expected a number"),
        (
            [*MATTE, "0.4", *USUAL, "--free", "gain", "--spread", "3deg"],
            "--spread has no effect: angle is not free",
        ),
        ([*MATTE, "0.4", *USUAL, "--free", "roughness"], "--free roughness belongs to --surface"),
        ([*MATTE, "0.4", *USUAL, "--interest", "gain"], "interest names 'gain'"),
        ([*MATTE, "0.4", *USUAL, "--output", FLAT], "is a file; expected a folder"),
        (
            ["plan", "--material", "specular", "--index", "1.5", *USUAL, "--illumination", "directional:45,0"],
            "delta",
        ),
        (
            [
                "plan",
                "--surface",
                "beckmann",
                "--roughness",
                "1",
                "--spread",
                "3deg",
                *MATTE[1:],
                "0.4",
                *USUAL[2:],
            ],
            "roughness",
        ),
    ],
)
def test_bad_input_is_told_in_one_line(capsys, argv, said):
    assert said in refusal(capsys, *argv)


def test_words_of_directions():
    assert words.polar_grid("-20:20:10") == [-20, -10, 0, 10, 20]
    assert words.azimuth_grid("0,90") == [0, 90]
    assert words.direction("30") == (30, 0)
    assert words.direction("30,90") == (30, 90)
    assert words.half_width("3deg") == (3, "deg")
    assert words.half_width("3°") == (3, "deg")
    assert words.half_width("0.05") == (0.05, "")
