"""`vcavity design`: what it prints and writes, and which key of the file is wrong."""

import json
from pathlib import Path

import pytest

from fitting.cli import BAD_INPUT, NO_ANSWER, main

EXAMPLE = Path(__file__).parents[2] / "examples" / "orange_fold.toml"
SCENE = """
[scene]
material = "lambertian"
reflectance = 0.5
wavelengths_nm = [400, 700, 20]
"""
ANGLE = "[parameters.angle]\n"
WISH = "[[target]]\nlab = [50, 0, 0]\n"


def test_the_example_meets_its_targets(capsys, tmp_path):
    assert main(["design", str(EXAMPLE), "--output", str(tmp_path / "found.json")]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "a deep orange: ΔE00" in out
    assert "every target is met." in out
    assert f"wrote {tmp_path / 'found.json'}" in out
    told = json.loads((tmp_path / "found.json").read_text())
    assert told["solutions"][0]["parameters"]["angle"] == pytest.approx(66, abs=2)  # 70 without the limit


def test_a_missed_target_has_status_1(capsys, tmp_path):
    file = tmp_path / "gray.toml"
    file.write_text(SCENE + ANGLE + WISH.replace("50, 0, 0", "50, 60, 0"))
    assert main(["design", str(file), "--json"]) == NO_ANSWER
    out, err = capsys.readouterr()
    assert json.loads(out)["met"] is False
    assert err.startswith("vcavity: not met: Lab 50, 60, 0 at 0 deg, D65 (ΔE00")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "scene.material: missing; expected one of: specular"),
        ('[scene]\nmaterial = "lambertian"\n', "scene.wavelengths_nm: missing; expected [first, last, step]"),
        (SCENE + ANGLE, "target: missing; expected [[target]]"),
        (SCENE + WISH, "parameters: missing; expected a table such as [parameters.angle]"),
        (
            SCENE + ANGLE + "[target]\nlab = [50, 0, 0]\n",
            "target: a table; expected [[target]], in double brackets",
        ),
        (SCENE + ANGLE + "[[target]]\nlap = [50, 0, 0]\n", "target[1].lap: unknown key; did you mean lab?"),
        (SCENE + ANGLE + "[[target]]\nlab = [50, 0]\n", "target[1].lab: a list; expected three numbers"),
        (SCENE + ANGLE + "[[target]]\npolar_deg = 3\n", "target[1]: none of them; expected one of lab"),
        (SCENE + ANGLE + WISH + "step = 0\n", "target[1].step: 0; expected a number above 0"),
        (SCENE + ANGLE + WISH + 'illuminant = "D93"\n', "target[1].illuminant: the text 'D93'"),
        (SCENE + ANGLE + WISH + "polar_deg = 90\n", "target[1].polar_deg: 90; expected above -90"),
        (SCENE + ANGLE + WISH + 'illumination = "sun"\n', "target[1].illumination: "),
        (SCENE + ANGLE + "[[target]]\ndifferent = 3\n", "target[1].looks: expected two looks"),
        (SCENE + ANGLE + WISH + "looks = [{}, {}]\n", "target[1].looks: beside lab"),
        (SCENE + ANGLE + "[[target]]\nspectrum = 'none.csv'\n", "none.csv"),
        (SCENE.replace("20]", "0]") + ANGLE + WISH, "scene.wavelengths_nm: [400, 700, 0]; expected 0 < first"),
        (SCENE.replace("400", "500") + ANGLE + WISH, "500 to 700 nm do not cover 400 to 700 nm"),
        (SCENE + "angle_deg = 60\n[parameters.gain]\n" + WISH, "belongs to an instrument"),
        (SCENE + ANGLE + WISH + "[search]\nstarts = 0\n", "search.starts: 0; expected a whole number"),
    ],
)
def test_bad_input_names_the_key(capsys, tmp_path, text, said):
    file = tmp_path / "wish.toml"
    file.write_text(text)
    assert main(["design", str(file)]) == BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert f"{file}: " in err or "none.csv: no such file" in err
    assert said in err


def test_a_missing_file(capsys):
    assert main(["design", "nowhere.toml"]) == BAD_INPUT
    assert "nowhere.toml: no such file" in capsys.readouterr().err
