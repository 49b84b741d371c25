"""The files of instruments: read as they are, asked about what they do not say, written so that they read back."""

import sys
import time
from pathlib import Path

import colour_cxf
import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Measurement, read_spectrum
from fitting.cli import main
from fitting.measurement import same_light
from fitting.readers import geometry

EXAMPLES = Path(__file__).parents[2] / "examples" / "data"

CGATS = """CGATS.17
ORIGINATOR "A spectrophotometer"
CREATED "2026-11-27"
{head}
NUMBER_OF_FIELDS 6
BEGIN_DATA_FORMAT
SAMPLE_ID SAMPLE_NAME LAB_L SPEC_400 SPEC_410 SPEC_420
END_DATA_FORMAT
NUMBER_OF_SETS 2
BEGIN_DATA
1 "matte orange" 52,1 0.10 0.11 0.12
2 "gold" 80.5 0.30 0.31 0.32
END_DATA
"""
DECLARED = 'MEASUREMENT_GEOMETRY "d/8 SCI"\nSPECTRAL_NORM "1.000000"'

CXF = """<?xml version="1.0" encoding="UTF-8"?>
<cc:CxF xmlns:cc="http://colorexchangeformat.com/CxF3-core"
        xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">
 <cc:FileInformation><cc:Creator>a lab</cc:Creator>
 <cc:CreationDate>2026-11-27T00:00:00-08:00</cc:CreationDate><cc:Description>chart</cc:Description>
 </cc:FileInformation>
 <cc:Resources><cc:ObjectCollection>
  <cc:Object ObjectType="Target" Name="cyan" Id="1"><cc:CreationDate>2026-11-27T00:00:00-08:00</cc:CreationDate>
   <cc:ColorValues><cc:ReflectanceSpectrum StartWL="{start}" ColorSpecification="CS1">0.10 0.20 0.30
   </cc:ReflectanceSpectrum></cc:ColorValues></cc:Object>
  <cc:Object ObjectType="Target" Name="red" Id="2"><cc:CreationDate>2026-11-27T00:00:00-08:00</cc:CreationDate>
   <cc:ColorValues><cc:ReflectanceSpectrum StartWL="{start}" ColorSpecification="CS1">0.4 0.5 0.6
   </cc:ReflectanceSpectrum></cc:ColorValues></cc:Object>
 </cc:ObjectCollection>
 <cc:ColorSpecificationCollection><cc:ColorSpecification Id="CS1">
  <cc:MeasurementSpec><cc:MeasurementType>Spectrum_Reflectance</cc:MeasurementType>
  <cc:GeometryChoice>{choice}</cc:GeometryChoice>
  <cc:WavelengthRange StartWL="{start}" Increment="10"/></cc:MeasurementSpec>
 </cc:ColorSpecification></cc:ColorSpecificationCollection></cc:Resources></cc:CxF>
"""
RING = (
    "<cc:SingleAngle><cc:SingleAngleConfiguration>{}</cc:SingleAngleConfiguration>"
    "<cc:IlluminationAngle>45</cc:IlluminationAngle><cc:MeasurementAngle>0</cc:MeasurementAngle></cc:SingleAngle>"
)

JCAMP = """##TITLE= a print
##JCAMP-DX= 4.24
##DATA TYPE= INFRARED SPECTRUM
##ORIGIN= a lab
##XUNITS= {x}
##YUNITS= {y}
##XFACTOR= 1.0
##YFACTOR= {factor}
##FIRSTX= 400
##LASTX= 430
##NPOINTS= 4
##XYDATA= (X++(Y..Y))
400 10 20 30 40
##END=
"""

TM27 = """<?xml version="1.0" encoding="UTF-8"?>
<IESTM2714 xmlns="iestm2714" version="1.0">
 <Header><Manufacturer>a lab</Manufacturer><CatalogNumber>1</CatalogNumber><Description>flat</Description>
 <DocumentCreator>me</DocumentCreator><UniqueIdentifier>1</UniqueIdentifier><MeasurementEquipment>e</MeasurementEquipment>
 <Laboratory>l</Laboratory><ReportNumber>1</ReportNumber><ReportDate>2026</ReportDate>
 <DocumentCreationDate>2026</DocumentCreationDate><Comments>none</Comments></Header>
 <SpectralDistribution><SpectralQuantity>{quantity}</SpectralQuantity>
 <ReflectionGeometry>{geometry}</ReflectionGeometry>
 <SpectralData wavelength="400">0.25</SpectralData><SpectralData wavelength="410.5">0.5</SpectralData>
 </SpectralDistribution></IESTM2714>
"""


@pytest.fixture
def file(tmp_path: Path):
    def make(text: str | bytes, name: str = "measured.txt") -> Path:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return make


def refusal(path: Path, **options: object) -> str:
    with pytest.raises(ValueError, match=r"\S") as caught:
        Measurement.read(path, **options)
    said = str(caught.value)
    assert "\n" not in said
    assert str(path) in said
    assert len(said) < 500
    return said.replace(str(path), "FILE")


def test_cgats(file) -> None:
    m = Measurement.read(file(CGATS.format(head=DECLARED)), column="gold")
    np.testing.assert_array_equal(m.wavelengths_nm, [400, 410, 420])
    np.testing.assert_array_equal(m.reflectance_factor, [[0.30, 0.31, 0.32]])
    np.testing.assert_allclose(np.rad2deg(m.polar), [8])
    assert same_light(m.illumination, vc.Diffuse())
    assert m.metadata["originator"] == "A spectrophotometer"
    assert m.metadata["sample"] == "gold"
    excluded = CGATS.format(head=DECLARED.replace("SCI", "SCE"))
    assert type(Measurement.read(file(excluded), column="gold").illumination).__name__ == "DiffuseWithTrap"


def test_what_a_file_does_not_say_is_asked_for_by_name(file) -> None:
    path = file(CGATS.format(head=""))
    assert "2 samples; expected column= one of: matte orange, gold" in refusal(path)
    assert "does not say how the light came" in refusal(path, column="gold")
    said = refusal(path, column="gold", geometry="45a:0")
    assert "FILE:12: the file does not say whether its values, up to 0.32, are fractions or percent" in said
    m = Measurement.read(path, column="gold", geometry="45a:0", reflectance_unit="percent")
    np.testing.assert_allclose(m.reflectance_factor, [[0.0030, 0.0031, 0.0032]], rtol=1e-15)
    assert same_light(m.illumination, vc.Annular(np.pi / 4))
    assert "no sample 'golf' (did you mean 'gold'?)" in refusal(path, column="golf")


def test_what_a_file_says_is_not_contradicted(file) -> None:
    path = file(CGATS.format(head='GEOMETRY "45/0"\nSPECTRAL_NORM 100'))
    assert "'45/0' may be 45a:0, 45x:0; expected geometry=" in refusal(path, column="gold")
    assert "'45/0', which is not d:8" in refusal(path, column="gold", geometry="d:8")
    assert "the file declares percent" in refusal(
        path, column="gold", geometry="45x:0", reflectance_unit="fraction"
    )
    m = Measurement.read(path, column="gold", geometry="45x:0", geometry_azimuth_deg=90.0)
    assert same_light(m.illumination, vc.Directional(np.pi / 4, np.pi / 2))
    np.testing.assert_allclose(m.reflectance_factor[0, 0], 0.003)
    for options, said in (
        ({"geometry": "8/d"}, "geometry '8/d' is unknown (did you mean '8:d'?)"),
        ({"geometry": "d:0", "geometry_azimuth_deg": 3.0}, "geometry_azimuth_deg has no effect in d:0"),
    ):
        with pytest.raises(ValueError, match=r"expected") as caught:
            Measurement.read(path, **options)
        assert said in str(caught.value)


@pytest.mark.parametrize(
    ("said", "specular", "names"),
    [
        ("45°/0°", "", ("45a:0", "45x:0")),
        ("45°a:0°", "", ("45a:0",)),
        ("0:45c", "", ("45a:0",)),
        ("0/45 annular", "", ("45a:0",)),
        ("D/8 SCI", "", ("di:8",)),
        ("di:8", "", ("di:8",)),
        ("de:8°", "", ("de:8",)),
        ("8:de", "", ("de:8",)),
        ("d/8", "excluded", ("de:8",)),
        ("d/8", "", ("di:8", "de:8", "d:8")),
        ("8/d", "", ("8:d",)),
        ("d:0", "", ("d:0",)),
        ("0:d", "", ("0:d",)),
        ("d:d", "", ("d:d",)),
        ("25/0", "", ()),
        ("MeasurementCondition=M1", "", ()),
    ],
)
def test_words_of_geometry(said: str, specular: str, names: tuple[str, ...]) -> None:
    assert geometry.understood(said, specular) == names
    assert set(names) <= set(geometry.GEOMETRIES)


NUISANCES = {
    "byte order mark": lambda text: b"\xef\xbb\xbf" + text.encode(),
    "CRLF": lambda text: text.replace("\n", "\r\n").encode(),
    "CR": lambda text: text.replace("\n", "\r").encode(),
    "Latin-1": lambda text: text.replace("A spectrophotometer", "Gerät für Öl").encode("latin-1"),
    "decimal commas": lambda text: text.replace("0.", "0,").replace("80.5", "80,5").encode(),
    "trailing blanks": lambda text: text.replace("\n", "  \n").encode(),
    "tabs": lambda text: text.replace('"matte orange"', "matte").replace(" 0.", "\t0.").encode(),
    "tabs, names with spaces": lambda text: (
        text.replace('"matte orange" ', "matte orange\t")
        .replace('"gold" ', "gold\t")
        .replace("1 matte", "1\tmatte")
        .replace("2 gold", "2\tgold")
        .replace(" 0.", "\t0.")
        .replace(
            "SAMPLE_ID SAMPLE_NAME LAB_L SPEC_400 SPEC_410 SPEC_420",
            "SAMPLE_ID\tSAMPLE_NAME\tLAB_L\tSPEC_400\tSPEC_410\tSPEC_420\t",
        )
        .encode()
    ),
    "comments": lambda text: (
        text.replace("BEGIN_DATA\n", "BEGIN_DATA\n\n").replace("NUMBER", "# a comment\nNUMBER").encode()
    ),
    "NM fields": lambda text: text.replace("SPEC_4", "SPECTRAL_NM4").encode(),
    "nm fields": lambda text: text.replace("SPEC_4", "nm4").encode(),
    "R_ fields": lambda text: text.replace("SPEC_4", "R_4").encode(),
    "420nm fields": lambda text: (
        text.replace("SPEC_400", "400nm").replace("SPEC_410", "410nm").replace("SPEC_420", "420nm").encode()
    ),
}


@pytest.mark.parametrize("nuisance", NUISANCES)
def test_nuisances(file, nuisance: str) -> None:
    m = Measurement.read(file(NUISANCES[nuisance](CGATS.format(head=DECLARED))), column="gold")
    np.testing.assert_array_equal(m.reflectance_factor, [[0.30, 0.31, 0.32]])
    np.testing.assert_array_equal(m.wavelengths_nm, [400, 410, 420])


def test_fields_that_declare_their_scale(file) -> None:
    pairs = CGATS.format(head='GEOMETRY "d:0"')
    pairs = pairs.replace("SPEC_400 SPEC_410 SPEC_420", "SPECTRAL_NM SPECTRAL_PCT SPECTRAL_NM SPECTRAL_PCT")
    pairs = pairs.replace("0.10 0.11 0.12", "400 10 410 11").replace("0.30 0.31 0.32", "400 30 410 31")
    m = Measurement.read(file(pairs), column="gold")
    np.testing.assert_array_equal(m.wavelengths_nm, [400, 410])
    np.testing.assert_allclose(m.reflectance_factor, [[0.30, 0.31]], rtol=1e-15)
    m = Measurement.read(
        file(pairs.replace("PCT", "DEC").replace(" 30 ", " 0.3 ").replace(" 31", " 0.31")), column="gold"
    )
    np.testing.assert_allclose(m.reflectance_factor, [[0.30, 0.31]], rtol=1e-15)
    assert "different wavelengths" in refusal(file(pairs.replace("30 410", "30 412")), column="gold")


def test_wavelengths_that_names_round(file) -> None:
    head = DECLARED + '\nSPECTRAL_BANDS "3"\nSPECTRAL_START_NM "400"\nSPECTRAL_END_NM "406.666667"'
    text = CGATS.format(head=head).replace("SPEC_410", "SPEC_403").replace("SPEC_420", "SPEC_407")
    np.testing.assert_allclose(
        Measurement.read(file(text), column="gold").wavelengths_nm, [400, 403.3333335, 406.666667]
    )


def test_thousands_of_columns(file) -> None:
    """3000 wavelengths and 2000 other fields, in seconds."""
    fields = [f"X{i}" for i in range(2000)] + [f"SPEC_{400 + i / 10:.1f}" for i in range(3000)]
    row = ["1"] * 2000 + ["0.5"] * 3000
    lines = [
        "CGATS.17",
        'GEOMETRY "d:0"',
        "SPECTRAL_NORM 1",
        "BEGIN_DATA_FORMAT",
        " ".join(fields),
        "END_DATA_FORMAT",
    ]
    lines += ["NUMBER_OF_SETS 50", "BEGIN_DATA", *([" ".join(row)] * 50), "END_DATA"]
    start = time.perf_counter()
    m = Measurement.read(file("\n".join(lines)), column="7")
    assert m.reflectance_factor.shape == (1, 3000)
    samples = "wavelength_nm," + ",".join(f"s{i}" for i in range(5000)) + "\n"
    samples += "".join(f"{400 + k}," + ",".join(["0.5"] * 5000) + "\n" for k in range(50))
    m = Measurement.read(file(samples), column="s4999")
    assert m.reflectance_factor.shape == (1, 50)
    assert time.perf_counter() - start < 20


def test_trailing_separators_of_native_files(file) -> None:
    m = Measurement.read(file("wavelength_nm;reflectance_factor;\n400;0.5;\n410;0.6;\n"))
    np.testing.assert_array_equal(m.reflectance_factor, [[0.5, 0.6]])


def test_a_geometry_for_two_columns(file) -> None:
    path = file("400 0.5\n410 0.6\n")
    assert same_light(Measurement.read(path, geometry="8:d").illumination, vc.Directional(np.deg2rad(8.0)))
    said = refusal(file("# illumination: diffuse\n400 0.5\n"), geometry="d:8")
    assert said == "FILE:1: the file states illumination; expected no geometry= beside it"


BAD_CGATS = {
    "cut off": (
        lambda t: t.partition("END_DATA\n")[0] + "END_DATA_FORMAT\nBEGIN_DATA\n1 a 1 1 1 1\n",
        "has no end",
    ),
    "missing rows": (lambda t: t.replace("SETS 2", "SETS 3"), ":14: 2 rows of data; expected NUMBER_OF_SETS 3"),
    "ragged": (lambda t: t.replace("0.10 0.11", "0.10"), ":12: 5 cells in this row; expected 6"),
    "word": (lambda t: t.replace("0.31", "o.31"), ":13: SPEC_410 is 'o.31', not a number"),
    "order": (lambda t: t.replace("SPEC_420", "SPEC_405"), "405 nm comes after 410 nm"),
    "negative": (lambda t: t.replace("0.31", "-0.31"), "below zero by more than noise"),
    "percent": (lambda t: t.replace("0.31", "31"), "looks like percent"),
    "infinite": (lambda t: t.replace("0.31", "inf"), "expected a finite number"),
    "no spectra": (lambda t: t.replace("SPEC_", "XYZ_"), "0 tables with spectral fields"),
    "nested": (lambda t: t.replace("END_DATA_FORMAT", "BEGIN_DATA"), "BEGIN_DATA within the block of line"),
    "missing values": (lambda t: t.replace("0.30 0.31 0.32", "nan nan nan"), "no value"),
}


@pytest.mark.parametrize("case", BAD_CGATS)
def test_bad_cgats(file, case: str) -> None:
    change, said = BAD_CGATS[case]
    assert said in refusal(file(change(CGATS.format(head=DECLARED))), column="gold")


def test_cxf(file) -> None:
    text = CXF.format(start=400, choice="<cc:SphereGeometry>Specular_Excluded</cc:SphereGeometry>")
    path = file(text, "chart.cxf")
    m = Measurement.read(path, column="red")
    np.testing.assert_array_equal(m.reflectance_factor, [[0.4, 0.5, 0.6]])
    np.testing.assert_array_equal(m.wavelengths_nm, [400, 410, 420])
    assert type(m.illumination).__name__ == "DiffuseWithTrap"
    assert m.metadata["description"] == "chart"
    wavelengths, values, _ = read_spectrum(path, column="cyan")
    np.testing.assert_array_equal(values, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(wavelengths, [400, 410, 420])


def test_cxf_as_colour_cxf_has_it() -> None:
    """A chart of an instrument's maker that comes with that package, all its objects."""
    path = Path(colour_cxf.__file__).parent / "tests" / "resources" / "sample.cxf"
    theirs = colour_cxf.read_cxf_from_file(path)
    objects = theirs.resources.object_collection.object_value
    assert len(objects) > 100
    for one in objects[:: len(objects) // 20]:
        m = Measurement.read(path, column=one.name, geometry="45a:0")
        spectrum = next(v for v in one.color_values.choice if type(v).__name__ == "ReflectanceSpectrum")
        np.testing.assert_array_equal(m.reflectance_factor, [spectrum.value])
        assert m.wavelengths_nm[0] == spectrum.start_wl


def test_cxf_beyond_the_schema(file) -> None:
    """A start below 360 nm and decimal commas: the schema refuses them, an instrument writes them."""
    text = CXF.format(start=340, choice=RING.format("Annular")).replace("0.4 0.5 0.6", "0,4 0,5 0,6")
    m = Measurement.read(file(text, "chart.cxf"), column="red")
    np.testing.assert_array_equal(m.wavelengths_nm, [340, 350, 360])
    np.testing.assert_array_equal(m.reflectance_factor, [[0.4, 0.5, 0.6]])
    assert same_light(m.illumination, vc.Annular(np.pi / 4))


def test_cxf_asks(file) -> None:
    text = CXF.format(start=400, choice=RING.format("Uniplanar"))
    assert "2 samples; expected column= one of: cyan, red" in refusal(file(text))
    unknown = CXF.format(start=400, choice="<cc:UnknownGeometry>x</cc:UnknownGeometry>")
    assert "does not say how the light came" in refusal(file(unknown), column="red")
    assert "no Increment" in refusal(file(text.replace('Increment="10"', "")), column="red")
    assert "'o.5' in its spectrum" in refusal(file(text.replace("0.5", "o.5")), column="red")
    assert "no ReflectanceSpectrum" in refusal(file(text.replace("ReflectanceSpectrum", "EmissiveSpectrum")))
    assert "looks like percent" in refusal(file(text.replace("0.4 0.5", "40 50")), column="red")


def test_jcamp(file) -> None:
    m = Measurement.read(file(JCAMP.format(x="NANOMETERS", y="REFLECTANCE", factor=0.01)), geometry="d:0")
    np.testing.assert_array_equal(m.wavelengths_nm, [400, 410, 420, 430])
    np.testing.assert_allclose(m.reflectance_factor, [[0.1, 0.2, 0.3, 0.4]], rtol=1e-15)
    assert m.metadata["origin"] == "a lab"
    percent = Measurement.read(file(JCAMP.format(x="MICROMETERS", y="% REFLECTANCE", factor=1)), geometry="d:0")
    np.testing.assert_allclose(percent.reflectance_factor, m.reflectance_factor)
    np.testing.assert_allclose(percent.wavelengths_nm, 1000 * m.wavelengths_nm)
    waves = Measurement.read(file(JCAMP.format(x="1/CM", y="REFLECTANCE", factor=0.01)), geometry="d:0")
    np.testing.assert_allclose(waves.wavelengths_nm, 1e7 / np.array([430, 420, 410, 400]))
    np.testing.assert_allclose(waves.reflectance_factor, [[0.4, 0.3, 0.2, 0.1]])
    text = JCAMP.format(x="NANOMETERS", y="TRANSMITTANCE", factor=0.01)
    np.testing.assert_allclose(read_spectrum(file(text), quantity="transmittance")[1], [0.1, 0.2, 0.3, 0.4])


def test_bad_jcamp(file, monkeypatch) -> None:
    good = JCAMP.format(x="NANOMETERS", y="REFLECTANCE", factor=0.01)
    assert "does not say how the light came" in refusal(file(good))
    assert "XUNITS is 'SECONDS'" in refusal(file(good.replace("NANOMETERS", "SECONDS")))
    assert "YUNITS is 'ABSORBANCE'; expected REFLECTANCE" in refusal(
        file(good.replace("REFLECTANCE", "ABSORBANCE"))
    )
    assert ":11: NPOINTS is 4e+12" in refusal(file(good.replace("POINTS= 4", "POINTS= 4000000000000")))
    assert "repeats 10 000 times" in refusal(file(good.replace("10 20 30", "10S999999999")))
    assert "Mismatch of array lengths found" in refusal(file(good.replace("POINTS= 4", "POINTS= 7")))
    assert "not as JCAMP-DX has it" in refusal(file(good.replace("##FIRSTX= 400\n", "")))
    monkeypatch.setitem(sys.modules, "jcamp", None)
    assert "needs the package jcamp (pip install 'vcavity[jcamp]')" in refusal(file(good))


def test_tm27(file) -> None:
    path = file(TM27.format(quantity="reflectance", geometry="di:8"), "flat.spdx")
    m = Measurement.read(path)
    np.testing.assert_array_equal(m.wavelengths_nm, [400, 410.5])
    np.testing.assert_array_equal(m.reflectance_factor, [[0.25, 0.5]])
    np.testing.assert_allclose(np.rad2deg(m.polar), [8])
    assert m.metadata["title"] == "flat"
    other = file(TM27.format(quantity="reflectance", geometry="other"), "flat.spdx")
    assert "does not say how the light came" in refusal(other)
    assert Measurement.read(other, geometry="d:d").hemispherical
    assert "SpectralQuantity is flux; expected reflectance" in refusal(
        file(TM27.format(quantity="flux", geometry="di:8"))
    )
    assert "not as TM-27 has it" in refusal(
        file(TM27.format(quantity="reflectance", geometry="di:8").replace("0.25", "x"))
    )


BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"<?xml version='1.0'?>{BOMB}]><CxF>&i;</CxF>", "declares a document type or entities"),
        ('<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><CxF>&e;</CxF>', "declares a document type"),
        ('<!DOCTYPE x SYSTEM "http://example.org/x.dtd"><CxF/>', "declares a document type"),
        ("<CxF><Resources>", "not well-formed XML"),
        ("<CxF/>", "no ReflectanceSpectrum"),
        ("<svg/>", "XML of the kind 'svg'; expected CxF or IESTM2714"),
        ("<?xml version='1.0' encoding='nonsense'?><CxF/>", "cannot be decoded"),
        ("<", "not well-formed XML"),
    ],
)
def test_hostile_xml(file, text: str, said: str) -> None:
    assert said in refusal(file(text))


SOUND = {
    "CGATS": CGATS.format(head=DECLARED + '\nREFLECTANCE_UNIT "fraction"\nSPECTRAL_BANDS 3'),
    "CxF3": CXF.format(start=400, choice=RING.format("Annular")),
    "JCAMP-DX": JCAMP.format(x="NANOMETERS", y="REFLECTANCE", factor=0.01),
    "TM-27": TM27.format(quantity="reflectance", geometry="di:8"),
}


@pytest.mark.parametrize("kind", SOUND)
def test_damaged_files_end_in_one_line(tmp_path: Path, kind: str) -> None:
    """Bytes changed, left out, doubled, moved: a measurement or one line that names the file, nothing else."""
    random = np.random.default_rng(8)
    whole = SOUND[kind].encode()
    read, said = 0, []
    for trial in range(40 if kind == "TM-27" else 300):
        data = bytearray(whole)
        for _ in range(random.integers(1, 4)):
            at, width = int(random.integers(len(data))), int(random.integers(1, 12))
            change = random.integers(5)
            if change == 0:
                data[at] = int(random.integers(256))
            elif change == 1:
                del data[at : at + width]
            elif change == 2:
                data[at:at] = data[at : at + width]
            elif change == 3:
                data[at : at + width] = random.choice(
                    ["9" * 30, "1e999", "-", "nan", '"', "0x1F", "1,5", "²"]
                ).encode()
            else:
                data = data[: max(at, 1)]
        path = tmp_path / f"{trial}.txt"
        path.write_bytes(bytes(data))
        try:
            column = {"CGATS": "gold", "CxF3": "red"}.get(kind)
            Measurement.read(path, column=column, geometry="d:0" if kind == "JCAMP-DX" else None)
            read += 1
        except ValueError as error:
            said.append((str(path), str(error)))
    assert said
    assert all(path in message and "\n" not in message for path, message in said)
    assert read > 0 or kind == "TM-27"


def test_a_gigabyte_of_digits(tmp_path: Path) -> None:
    """Of no format, in one line, without being read; and smaller ones that are."""
    for head, name in (
        ("", "a.csv"),
        ("BEGIN_DATA_FORMAT\n", "a.ti3"),
        ("<CxF>", "a.cxf"),
        ("##TITLE=a\n", "a.jdx"),
    ):
        path = tmp_path / name
        with path.open("wb") as stream:
            stream.write(head.encode())
            stream.truncate(1 << 30)
        start = time.perf_counter()
        assert "larger than" in refusal(path)
        path.write_bytes(head.encode() + b"1" * 20_000_000)
        refusal(path)
        assert time.perf_counter() - start < 10


def measured(*arrays, **others) -> Measurement:
    return Measurement(*(np.asarray(array, float) for array in arrays), **others)


MEASUREMENTS = {
    "directions": lambda r: measured(
        [400.0, 410.5, 1000.0],
        np.deg2rad([0, 30.1, -60]),
        np.deg2rad([0, 45, 90]),
        r.uniform(size=(3, 3)),
        r.uniform(0.001, 1, (3, 3)),
    ),
    "missing values": lambda r: measured([400, 500], [0.1], [0.2], [[0.5, np.nan]]),
    "directional": lambda r: measured([400], [0.5], [0.1], [[0.5]], illumination=vc.Directional(0.3, -0.4)),
    "annular": lambda r: measured([400], [0.5], [0.1], [[0.5]], illumination=vc.Annular(0.7)),
    "d:d": lambda r: measured([400], [np.nan], [np.nan], [[0.5]], hemispherical=True),
    "8:d": lambda r: measured(
        [400], [np.nan], [np.nan], [[0.5]], illumination=vc.Directional(np.deg2rad(8), 0.3), hemispherical=True
    ),
    "de:8": lambda r: measured(
        [400], [np.deg2rad(8)], [0.2], [[0.5]], illumination=vc.cie_geometry("de:8", 0.2)[0]
    ),
}


@pytest.mark.parametrize("suffix", ["csv", "ti3", "txt", "cgats"])
@pytest.mark.parametrize("kind", MEASUREMENTS)
def test_what_is_written_reads_back_equal(tmp_path: Path, kind: str, suffix: str) -> None:
    m = MEASUREMENTS[kind](np.random.default_rng(5))
    path = tmp_path / f"written.{suffix}"
    m.write(path)
    back = Measurement.read(path)
    for name in ("wavelengths_nm", "reflectance_factor"):
        np.testing.assert_array_equal(getattr(back, name), getattr(m, name))
    for name in ("polar", "azimuth"):
        np.testing.assert_array_max_ulp(getattr(back, name), getattr(m, name), 1)
    assert (back.standard_uncertainty is None) == (m.standard_uncertainty is None)
    if m.standard_uncertainty is not None:
        np.testing.assert_array_equal(back.standard_uncertainty, m.standard_uncertainty)
    assert back.hemispherical == m.hemispherical
    assert same_light(back.illumination, m.illumination)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*-v*.csv")), ids=lambda path: path.stem)
def test_real_files_read_back_equal(tmp_path: Path, path: Path) -> None:
    m = Measurement.read(path)
    for name in ("a.csv", "a.ti3"):
        m.write(tmp_path / name)
        back = Measurement.read(tmp_path / name)
        for field in ("wavelengths_nm", "polar", "azimuth", "reflectance_factor", "standard_uncertainty"):
            np.testing.assert_array_equal(getattr(back, field), getattr(m, field))
    m.write(tmp_path / "b.csv")
    own = {key: value for key, value in m.metadata.items() if key not in ("illumination", "reflectance_unit")}
    assert {key: Measurement.read(tmp_path / "b.csv").metadata.get(key) for key in own} == own


def test_what_cannot_be_written(tmp_path: Path) -> None:
    m = measured([400], [0.5], [0.1], [[0.5]], illumination=vc.Mixed(0.5, vc.Directional(0.3, 0.0)))
    with pytest.raises(ValueError, match="light of the kind Mixed has no words in a file"):
        m.write(tmp_path / "a.csv")
    with pytest.raises(ValueError, match=r"unknown format '.xls'; expected a name that ends in .csv or .ti3"):
        m.write(tmp_path / "a.xls")
    far = measured([12_000], [0.5], [0.1], [[0.5]])
    with pytest.raises(ValueError, match="have no field in CGATS"):
        far.write(tmp_path / "a.ti3")
    assert not list(tmp_path.iterdir())


def test_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A prediction as CGATS, fitted; a file that must be told its geometry."""
    predicted = tmp_path / "gold.ti3"
    mirror = ["--material", "specular", "--index", "Au-Johnson"]
    argv = ["predict", "--angle", "45deg", *mirror, "--wavelengths", "400:700:20", "--polar", "0,30"]
    assert main([*argv, "--output", str(predicted)]) == 0
    assert predicted.read_text(encoding="utf-8").startswith("CGATS.17\n")
    assert main(["fit", str(predicted), *mirror, "--uncertainty", "0.01"]) == 0
    assert "45.0" in capsys.readouterr().out
    bare = tmp_path / "bare.ti3"
    bare.write_text(CGATS.format(head="SPECTRAL_NORM 1"))
    argv = ["fit", str(bare), *mirror, "--uncertainty", "0.01", "--column", "gold"]
    assert main(argv) == 2
    assert "expected --geometry with one of them" in capsys.readouterr().err
    bare.write_text(CGATS.format(head='GEOMETRY "d:0"'))
    assert main(argv) == 2
    assert "are fractions or percent; expected --reflectance-unit fraction or percent\n" in capsys.readouterr().err
    bare.write_text(CGATS.format(head="SPECTRAL_NORM 1"))
    assert main([*argv, "--geometry-azimuth", "90"]) == 2
    assert "--geometry-azimuth has no effect: expected --geometry d:8" in capsys.readouterr().err
    assert main([*argv, "--geometry", "di:8", "--geometry-azimuth", "90"]) in (0, 1)
