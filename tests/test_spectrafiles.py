"""Spectra of instruments' files: every way of writing them down is read to the same numbers."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest

from usdskin.errors import UsdSkinError
from usdskin.spectrafiles import (
    as_radiances,
    as_reflectances,
    read_spectra,
    single_spectrum,
)
from usdskin.spectrafiles.labels import wavelength
from usdskin.spectrafiles.read import MAX_BYTES
from usdskin.spectrafiles.units import radiometric_unit
from usdskin.spectrum import SpectralQuantity

NM = np.arange(380.0, 731.0, 10.0)
NAMES = ("dark skin", "light skin", "white 9.5 (.05 D)", "black 2 (1.5 D)")


def chart(scale=1.0):
    """Return four smooth spectra, rounded as instruments print them, shape [4, 36]."""
    phase = np.linspace(0.0, 3.0, NM.size)
    levels = np.array([0.1, 0.4, 0.9, 0.03])
    return np.round(scale * levels[:, None] * (0.7 + 0.3 * np.cos(phase + levels[:, None])), 6)


def write_table(
    path: Path,
    *,
    down: bool,
    delimiter=",",
    comma=False,
    label="{:g}",
    corner="nm",
    names=NAMES,
    values=None,
    before="",
    encoding="utf-8",
    newline="\n",
) -> Path:
    values = chart() if values is None else values

    def cell(value):
        return f"{value:.6f}".replace(".", ",") if comma else f"{value:.6f}"

    labels = [label.format(nm) for nm in NM]
    if comma:
        labels = [text.replace(".", ",") for text in labels]
    rows = [[corner, *labels]] + [
        [name, *map(cell, row)] for name, row in zip(names, values, strict=True)
    ]
    if down:
        rows = [list(row) for row in zip(*rows, strict=True)]
    text = io.StringIO()
    csv.writer(text, delimiter=delimiter, lineterminator=newline).writerows(rows)
    path.write_bytes((before + text.getvalue()).encode(encoding))
    return path


def assert_chart(file, names=NAMES, scale=1.0):
    assert file.names == tuple(names)
    np.testing.assert_array_equal(file.wavelength_nm, NM)
    np.testing.assert_allclose(file.values, chart(scale), rtol=0, atol=1e-12)


def refusal(path: Path, text: str | bytes) -> str:
    """Return the one line with which a file of this content is refused."""
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(UsdSkinError) as caught:
        read_spectra(path)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(str(path))
    return message


# Tables


@pytest.mark.parametrize("down", [True, False], ids=["down", "across"])
@pytest.mark.parametrize(
    ("delimiter", "comma"),
    [(",", False), (";", False), (";", True), ("\t", False), ("\t", True), (" ", False)],
)
@pytest.mark.parametrize("label", ["{:g}", "{:.1f}", "{:g}nm"])
def test_table_is_read_whichever_way_it_lies(tmp_path, down, delimiter, comma, label):
    path = tmp_path / "chart.txt"
    write_table(path, down=down, delimiter=delimiter, comma=comma, label=label)
    assert_chart(read_spectra(path))


@pytest.mark.parametrize(
    "label",
    "nm{:g}|NM_{:g}|R_{:g}|R_{:g}NM|SPECTRAL_NM{:g}|SPECTRAL_NM_{:g}|SPEC_{:g}|{:g} [nm]|"
    "{:g}_NM|X{:g}|Spectral Data {:g}[nm]|λ={:g}".split("|"),
)
@pytest.mark.parametrize("down", [True, False], ids=["down", "across"])
def test_wavelengths_are_read_from_every_heading(tmp_path, label, down):
    write_table(tmp_path / "chart.csv", down=down, label=label)
    assert_chart(read_spectra(tmp_path / "chart.csv"))


@pytest.mark.parametrize("text", ["A1", "1", "100.0", "2.5", "CES15", "RGB_R", "n5", "2024-05-01"])
def test_other_cells_are_no_wavelengths(text):
    assert wavelength(text) is None


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_encoding_and_line_ends_do_not_matter(tmp_path, encoding, newline):
    names = ("peau foncée", *NAMES[1:])
    path = tmp_path / "chart.csv"
    write_table(path, down=True, names=names, encoding=encoding, newline=newline)
    assert_chart(read_spectra(path), names)


def test_remarks_and_statements_are_kept_apart_from_the_data(tmp_path):
    before = (
        "# Instrument: CS-2000\n// quantity = reflectance\nDate;2024-05-01\n\n;;;;\nunits: %\n"
        "some title\n"
    )
    path = write_table(
        tmp_path / "chart.csv",
        down=True,
        delimiter=";",
        comma=True,
        values=chart(100),
        before=before,
    )
    file = read_spectra(path)
    assert_chart(file, scale=100)
    assert file.quantity is SpectralQuantity.REFLECTANCE and file.units == "%"
    assert file.metadata["instrument"] == "CS-2000" and file.metadata["date"] == "2024-05-01"


def test_remark_behind_numbers_and_a_hash_in_a_name(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("480 1.0e-1 # dark\n490 0.2\n500 0.3 # 2nd 4 times\n")
    np.testing.assert_array_equal(read_spectra(path).values, [[0.1, 0.2, 0.3]])
    path.write_text("name,400,410\nPatch #1,0.1,0.2\nPatch #2,0.3,0.4\n")
    assert read_spectra(path).names == ("Patch #1", "Patch #2")


def test_ocean_optics_file_is_read(tmp_path):
    data = "".join(f"{nm + 0.13:.2f}\t{0.001 * nm:.5f}\n" for nm in NM)
    head = "Data from lamp.txt Node\n\nDate: Mon Nov 02 10:00\nIntegration Time (sec): 1.0E-1\n"
    text = f"{head}>>>>>Begin Spectral Data<<<<<\n{data}>>>>>End Processed Spectral Data<<<<<\n"
    (tmp_path / "lamp.txt").write_text(text)
    file = read_spectra(tmp_path / "lamp.txt")
    np.testing.assert_allclose(file.wavelength_nm, NM + 0.13)
    assert file.metadata["integration time (sec)"] == "1.0E-1"


def test_more_columns_beside_the_spectra_are_passed_over(tmp_path):
    rows = ["Number,Name,L*,a*,b*," + ",".join(f"{nm:g}nm" for nm in NM) + ",Comment"]
    rows += [
        f"{index},{name},50,1,2," + ",".join(map(str, row)) + ","
        for index, (name, row) in enumerate(zip(NAMES, chart().tolist(), strict=True))
    ]
    (tmp_path / "chart.csv").write_text("\n".join(rows))
    assert_chart(read_spectra(tmp_path / "chart.csv"))


def test_table_without_names_counts_its_spectra(tmp_path):
    table = np.column_stack([NM, chart().T])
    np.savetxt(tmp_path / "down.txt", table)
    np.savetxt(tmp_path / "across.txt", table.T)
    for name in ("down.txt", "across.txt"):
        assert_chart(read_spectra(tmp_path / name), ("1", "2", "3", "4"))


def test_heading_without_a_corner_and_heading_in_a_comment(tmp_path):
    table = np.column_stack([NM, chart().T])
    np.savetxt(tmp_path / "numpy.csv", table, delimiter=",", header="nm,A1,A2,A3,A4")
    rows = [",".join(f"{nm:g}" for nm in NM)]
    rows += [f"A{1 + i}," + ",".join(map(str, row)) for i, row in enumerate(chart().tolist())]
    (tmp_path / "r.csv").write_text("\n".join(rows))
    for name in ("numpy.csv", "r.csv"):
        assert_chart(read_spectra(tmp_path / name), ("A1", "A2", "A3", "A4"))


def test_units_come_from_a_row_of_units_or_from_brackets(tmp_path):
    data = "".join(f"{nm:g};{a};{b}\n" for nm, a, b in zip(NM, *chart(1e3)[:2], strict=True))
    (tmp_path / "row.csv").write_text(f"wavelength;A1;A2\nnm;mW/(m² sr nm);mW/(m² sr nm)\n{data}")
    heading = "wavelength [nm];A1 [mW/m^2/sr/nm];A2 [mW/m^2/sr/nm]\n"
    (tmp_path / "brackets.csv").write_text(heading + data)
    for name in ("row.csv", "brackets.csv"):
        file = read_spectra(tmp_path / name)
        assert file.names == ("A1", "A2") and file.is_absolute
        assert file.quantity is SpectralQuantity.RADIANCE
        notes = []
        np.testing.assert_allclose(as_radiances(file, notes), 1e-3 * chart(1e3)[:2])
        assert [note.code for note in notes] == ["unit-changed"]


def test_sekonic_file_gives_its_finest_sweep(tmp_path):
    fine = np.arange(380.0, 781.0)
    rows = ["Title,tube 3", "Tcp [K],4230", "Illuminance [lx],512.0"]
    rows += [f"Spectral Data {nm:g}[nm],{0.001 * nm}" for nm in fine[::5]]
    rows += [f"Spectral Data {nm:g}[nm],{0.001 * nm}" for nm in fine]
    rows += ["CRI Ra,62.1", "TM-30 Color Vector Graphic,a,b,c,d", "1,0.3,0.3,0.3,0.3"]
    (tmp_path / "lamp.csv").write_text("\n".join(rows))
    notes = []
    file = read_spectra(tmp_path / "lamp.csv", notes)
    np.testing.assert_array_equal(file.wavelength_nm, fine)
    np.testing.assert_allclose(file.values[0], 0.001 * fine)
    assert [note.code for note in notes] == ["longest-sweep-read"]
    assert file.names == ("lamp",)


def test_unsorted_wavelengths_are_sorted_and_falling_ones_turned(tmp_path):
    order = np.random.default_rng(3).permutation(NM.size)
    for rows, codes in ((order, ["wavelengths-sorted"]), (np.arange(NM.size)[::-1], [])):
        text = "nm,a\n" + "".join(f"{NM[i]:g},{chart()[0, i]}\n" for i in rows)
        (tmp_path / "file.csv").write_text(text)
        notes = []
        file = read_spectra(tmp_path / "file.csv", notes)
        np.testing.assert_array_equal(file.wavelength_nm, NM)
        np.testing.assert_array_equal(file.values[0], chart()[0])
        assert [note.code for note in notes] == codes


# CGATS


def cgats(fields, keywords="", values=None, quoted=True, wide=True):
    values = chart() if values is None else values
    rows = []
    for index, (name, row) in enumerate(zip(NAMES, values, strict=True)):
        cells = [str(1 + index), f'"{name}"' if quoted else name, *(f"{v:.6f}" for v in row)]
        rows.append(("\t" if not quoted else " ").join(cells))
    return (
        f"CGATS.17\n{keywords}NUMBER_OF_FIELDS {len(fields)}\nBEGIN_DATA_FORMAT\n"
        + ("\n" if not wide else " ").join(fields)
        + f"\nEND_DATA_FORMAT\n\nNUMBER_OF_SETS {len(rows)}\nBEGIN_DATA\n"
        + "\n".join(rows)
        + "\nEND_DATA\n"
    )


def spectral_fields(form="SPECTRAL_NM{:g}"):
    return ["SAMPLE_ID", "SAMPLE_NAME", *(form.format(nm) for nm in NM)]


@pytest.mark.parametrize(
    "form", ["SPECTRAL_NM{:g}", "SPECTRAL_NM_{:g}", "nm{:g}", "SPEC_{:g}", "R_{:g}NM", "{:g}"]
)
@pytest.mark.parametrize("quoted", [True, False])
@pytest.mark.parametrize("wide", [True, False])
def test_cgats_of_every_writer(tmp_path, form, quoted, wide):
    keywords = 'ORIGINATOR "i1Profiler"\nINSTRUMENTATION "i1Pro 3"  # one\nKEYWORD "M"\n'
    text = cgats(spectral_fields(form), keywords, quoted=quoted, wide=wide)
    (tmp_path / "chart.txt").write_text(text)
    file = read_spectra(tmp_path / "chart.txt")
    assert_chart(file)
    assert file.metadata["instrumentation"] == "i1Pro 3"


def test_cgats_with_decimal_commas_folded_rows_and_another_table(tmp_path):
    text = cgats(spectral_fields())
    other = text.replace("SPECTRAL_NM", "CMYK_C").replace("SAMPLE_NAME", "STRING")
    head, data = text.split("BEGIN_DATA\n")
    folded = head + "BEGIN_DATA\n" + data.replace(" 0.0", "\n0.0").replace("0.", "0,")
    (tmp_path / "chart.cgats").write_text(other + "\n" + folded)
    assert_chart(read_spectra(tmp_path / "chart.cgats"))
    message = refusal(tmp_path / "two.cgats", text + text)
    assert "tables with spectra at lines" in message


def test_cgats_pairs_of_wavelength_and_percent(tmp_path):
    fields = ["SAMPLE_ID", "SAMPLE_NAME"] + ["SPECTRAL_NM", "SPECTRAL_PCT"] * NM.size
    values = np.stack([np.broadcast_to(NM, chart().shape), chart(100)], axis=-1)
    (tmp_path / "chart.txt").write_text(cgats(fields, values=values.reshape(4, -1)))
    file = read_spectra(tmp_path / "chart.txt")
    assert_chart(file, scale=100)
    np.testing.assert_allclose(as_reflectances(file, []), 0.01 * chart(100))


def argyll_spectrum(kind="EMISSION", norm=1.0, bands=106, start=380.0, end=730.0):
    """Return the text of an ArgyllCMS ``.sp`` file of sample values 1, 2, 3, ..."""
    exact = np.linspace(start, end, bands)
    fields = [f"SPEC_{round(float(nm))}" for nm in exact]
    keywords = {
        "DESCRIPTOR": "Argyll Spectral power/reflectance information",
        "MEAS_TYPE": kind,
        "SPECTRAL_BANDS": bands,
        "SPECTRAL_START_NM": f"{start:f}",
        "SPECTRAL_END_NM": f"{end:f}",
        "SPECTRAL_NORM": f"{norm:f}",
    }
    text = "SPECT  \n\n" + "".join(f'KEYWORD "{k}"\n{k} "{v}"\n' for k, v in keywords.items())
    text += "".join(f'KEYWORD "{name}"\n' for name in fields)
    text += f"NUMBER_OF_FIELDS {bands}\nBEGIN_DATA_FORMAT\n{' '.join(fields)} \nEND_DATA_FORMAT\n\n"
    data = " ".join(str(1.0 + index) for index in range(bands))
    return text + f"NUMBER_OF_SETS 1\nBEGIN_DATA\n{data} \nEND_DATA\n"


def test_argyll_spectrum_has_the_stated_wavelengths_and_milliwatts(tmp_path):
    """ArgyllCMS rounds wavelengths in names of fields, and measures in mW/(m^2 sr nm)."""
    path = tmp_path / "tube.sp"
    path.write_text(argyll_spectrum())
    file = read_spectra(path)
    assert file.names == ("tube",) and file.quantity is SpectralQuantity.RADIANCE
    np.testing.assert_allclose(file.wavelength_nm, 380.0 + np.arange(106) / 0.3)
    nm, power = single_spectrum(path)
    np.testing.assert_allclose(power, 1e-3 * (1.0 + np.arange(106)))
    np.testing.assert_array_equal(nm, file.wavelength_nm)


def test_argyll_reflectance_is_divided_by_its_norm(tmp_path):
    path = tmp_path / "grey.sp"
    path.write_text(argyll_spectrum("REFLECTIVE", norm=106.0))
    file = read_spectra(path)
    assert file.quantity is SpectralQuantity.REFLECTANCE
    np.testing.assert_allclose(as_reflectances(file, [])[0], (1.0 + np.arange(106)) / 106.0)
    with pytest.raises(UsdSkinError, match="holds reflectance"):
        single_spectrum(path)


def test_argyll_ti3_names_patches_by_their_place_in_the_chart(tmp_path):
    fields = ["SAMPLE_ID", "SAMPLE_LOC", *(f"SPEC_{nm:g}" for nm in NM)]
    text = cgats(fields, 'DEVICE_CLASS "OUTPUT"\n', values=chart(100))
    for index, name in enumerate(NAMES):
        text = text.replace(f'"{name}"', f'"{"AABB"[index]}{1 + index % 2}"')
    (tmp_path / "chart.ti3").write_text(text.replace("CGATS.17", "CTI3   "))
    file = read_spectra(tmp_path / "chart.ti3")
    assert_chart(file, ("A1", "A2", "B1", "B2"), scale=100)
    notes = []
    np.testing.assert_allclose(as_reflectances(file, notes), 0.01 * chart(100))
    assert [note.code for note in notes] == ["percent-divided"]


def test_damaged_cgats_is_refused(tmp_path):
    text = cgats(spectral_fields())
    lines = text.splitlines()
    path = tmp_path / "chart.cgats"
    assert "END_DATA" in refusal(path, text.replace("END_DATA\n", "").strip())
    assert "NUMBER_OF_SETS" in refusal(path, text.replace("NUMBER_OF_SETS 4", "NUMBER_OF_SETS 5"))
    assert "NUMBER_OF_FIELDS" in refusal(path, text.replace("FIELDS 38", "FIELDS 39"))
    assert "no spectral fields" in refusal(path, text.replace("SPECTRAL_NM", "CMYK_"))
    short = "\n".join([*lines[:-2], lines[-2].rsplit(" ", 1)[0], lines[-1]])
    assert f":{len(lines) - 1}: 37 values" in refusal(path, short)
    first = f"{chart()[0, 0]:.6f}"
    word = text.replace(first, "n/a", 1)
    bad = next(index for index, line in enumerate(lines, start=1) if first in line)
    assert f":{bad}, column 3: 'n/a' is not a number" in refusal(path, word)
    assert "contradict" in refusal(path, argyll_spectrum().replace('"730.', '"780.'))


# TM-27

SPDX = """<?xml version="1.0" encoding="utf-8"?>
<IESTM2714 xmlns="http://www.ies.org/iestm2714" version="1.0">
 <Header><Manufacturer>x</Manufacturer><Description>tube</Description></Header>
 <SpectralDistribution><SpectralQuantity>{quantity}</SpectralQuantity>
 <ReflectionGeometry>45/0</ReflectionGeometry><BandwidthFWHM>2.0</BandwidthFWHM>
{data}
 </SpectralDistribution>
</IESTM2714>
"""


def spdx(quantity="relative", values=None):
    values = chart()[0] if values is None else values
    rows = zip(NM, values, strict=True)
    data = "\n".join(f'<SpectralData wavelength="{a:.1f}">{b}</SpectralData>' for a, b in rows)
    return SPDX.format(quantity=quantity, data=data)


@pytest.mark.parametrize("quantity", ["reflectance", "radiance", "irradiance", "relative"])
def test_tm27_is_read_as_colour_science_reads_it(tmp_path, quantity):
    import colour

    path = tmp_path / "tube.spdx"
    path.write_text(spdx(quantity))
    theirs = colour.SpectralDistribution_IESTM2714(str(path)).read()
    file = read_spectra(path)
    np.testing.assert_array_equal(file.wavelength_nm, theirs.wavelengths)
    np.testing.assert_array_equal(file.values[0], theirs.values)
    assert file.quantity is not None and file.quantity.value == theirs.spectral_quantity
    assert file.metadata["reflectiongeometry"] == theirs.reflection_geometry == "45/0"
    assert file.names == ("tube",)
    assert file.is_absolute == (quantity in ("radiance", "irradiance"))


def test_tm27_of_another_edition_namespace_and_encoding(tmp_path):
    text = (
        spdx()
        .replace("IESTM2714", "IESTM2720")
        .replace(' xmlns="http://www.ies.org/iestm2714"', "")
    )
    (tmp_path / "a.xml").write_bytes(text.replace("utf-8", "utf-16").encode("utf-16"))
    np.testing.assert_array_equal(read_spectra(tmp_path / "a.xml").values[0], chart()[0])


def test_hostile_and_broken_xml_is_refused(tmp_path):
    path = tmp_path / "a.spdx"
    good = spdx()
    entity = '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]>'
    assert "DOCTYPE" in refusal(path, good.replace("<IESTM2714", entity + "<IESTM2714", 1))
    assert "cannot be read" in refusal(path, good[: len(good) // 2])
    assert "not of IES TM-27" in refusal(path, "<cc:CxF xmlns:cc='http://x'/>")
    assert "nested" in refusal(path, "<IESTM2714>" + "<a>" * 100_000)
    assert "64 KiB" in refusal(path, "<IESTM2714>" + "a" * 100_000)
    assert "no SpectralDistribution" in refusal(path, "<IESTM2714/>")
    assert "without SpectralData" in refusal(path, SPDX.format(quantity="radiance", data=""))
    assert ":7: SpectralData" in refusal(path, good.replace("390.0", ""))
    assert "no power" in refusal(path, spdx("photonirradiance"))
    assert "encoding" in refusal(path, good.replace("utf-8", "utf-c"))
    assert "nan at 390 nm" in refusal(path, good.replace(f"{chart()[0, 1]}<", "NaN<", 1))


# Folders


def test_folder_of_one_file_for_each_patch_is_a_chart(tmp_path):
    """As spectroradiometers save their readings, and as TM-27 has charts."""
    order = ("patch 1", "patch 2", "patch 10", "patch 11")
    for name, values in zip(order, chart(), strict=True):
        (tmp_path / f"{name}.spdx").write_text(spdx("radiance", values))
    (tmp_path / ".DS_Store").write_bytes(b"\x00")
    file = read_spectra(tmp_path)
    assert_chart(file, order)
    assert file.quantity is SpectralQuantity.RADIANCE and file.path == tmp_path


def test_folder_of_unlike_files_is_refused(tmp_path):
    first, second = tmp_path / "a.spdx", tmp_path / "b.spdx"
    first.write_text(spdx("radiance"))
    for text, message in (
        (spdx("irradiance"), "other quantity or unit than a.spdx"),
        (spdx("radiance").replace("390.0", "391.0"), "other wavelengths than a.spdx"),
        (cgats(spectral_fields()), "holds 4 spectra"),
    ):
        second.write_text(text)
        with pytest.raises(UsdSkinError, match=f"b.spdx: {message}"):
            read_spectra(tmp_path)
    second.rename(tmp_path / "a.txt")
    with pytest.raises(UsdSkinError, match=r"a\.txt: named as a\.spdx is"):
        read_spectra(tmp_path)


# What is refused in every kind


def lamp_rows(change=None):
    rows = [f"{nm:g},{value}" for nm, value in zip(NM, chart()[1], strict=True)]
    for index, row in (change or {}).items():
        rows[index] = row
    return "nm,lamp\n" + "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("400,nan", ":4, column 2: 'lamp' is nan at 400 nm"),
        ("400,inf", ":4, column 2: 'lamp' is inf at 400 nm"),
        ("400,", ":4, column 2: an empty cell"),
        ("400,abc", ":4, column 2: 'abc' is not a number"),
        ("400", ":4: '400' is no row of wavelength"),
        ("400,0.3,0.4", ":4: 3 cells where the table has 2"),
        ("4oo,0.3", ":4: '4oo,0.3' is no row of wavelength"),
        (",0.3", ":4: ',0.3' is no row of wavelength"),
        ("390,0.3", ":4, column 2: 390 nm a second time"),
        ("400,-0.3", ":4, column 2: 'lamp' is -0.3 at 400 nm, below zero"),
        ("400,1_0", ":4, column 2: '1_0' is not a number"),
    ],
)
def test_bad_cell_is_named_by_line_and_column(tmp_path, row, message):
    assert message in refusal(tmp_path / "lamp.csv", lamp_rows({2: row}))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("hello world\nthis is no table\n", "no wavelengths"),
        ("400," * 2**19, ":1: a line of more than 1 MiB"),
        ("1,2,3\n4,5,6\n7,8,9\n", "no wavelengths"),
        (b"\x00\x01\x02\x03" * 99, ":1: is not text"),
        (b"PK\x03\x04" + b"\x00" * 99, "Excel workbook"),
        ("".join(f"{nm},0.5\n" for nm in range(900, 1700, 10)), "not into 400 to 700 nm"),
        ("".join(f"{nm / 1000},0.5\n" for nm in range(380, 780, 10)), "seem to be in micrometres"),
        ("".join(f"{nm}e-9 0.5\n" for nm in range(380, 780, 10)), "seem to be in metres"),
        ("".join(f"{10 * nm};0,5\n" for nm in range(380, 780, 10)), "seem to be in angstroms"),
        ("".join(f"{nm},0\n" for nm in range(380, 780, 10)), "zero at every wavelength"),
        ("nm,a,a\n400,1,2\n500,1,2\n", "a second 'a'"),
        ("nm,a,\n400,1,2\n500,1,2\n", "without a name"),
        ("nm,a\n400,1,2\n500,1,2\n", ":1: a heading of 2 cells above rows of 3"),
        ("nm dark skin\n400 1\n500 1\n", ":1: a heading of 3 cells above rows of 2"),
        ("name,400,500\na,0.1,0.2\nb,0.1\n", ":3: 2 cells where the table has 3"),
        ("name,400,500\na,0.1,0.2\nb,,0.1\n", ":3, column 2: an empty cell"),
        ("name,400,500\na,0.1,0.2\nb,0.1,0.2,0.3\n", ":3: 4 cells where the table has 3"),
        ("name 400 500\nlight skin 0.1 0.2\nb 0.1 0.2\n", "names with blanks in quotes"),
    ],
)
def test_file_that_is_no_spectra_is_refused(tmp_path, text, message):
    assert message in refusal(tmp_path / "file.csv", text)


def test_damaged_wavelength_is_not_passed_over(tmp_path):
    """A table that breaks off at a bad wavelength would lose the better half of itself."""
    path = tmp_path / "chart.csv"
    text = write_table(path, down=False).read_text()
    assert ":1, column 5: '4l0' is no wavelength" in refusal(path, text.replace("410", "4l0", 1))
    text = write_table(path, down=True).read_text()
    assert ":2: '3b0," in refusal(path, text.replace("380", "3b0", 1))
    assert ":2: '38000," in refusal(path, text.replace("380", "38000", 1))
    text = cgats(spectral_fields())
    assert "'SPCTRAL_NM500' is no wavelength" in refusal(
        path, text.replace("SPECTRAL_NM5", "SPCTRAL_NM5", 1)
    )
    assert "SPECTRAL_BANDS is 36" in refusal(
        path,
        cgats(["SAMPLE_ID", "SAMPLE_NAME", "XYZ_X", *spectral_fields()[3:]], "SPECTRAL_BANDS 36\n"),
    )


def test_missing_wavelength_is_told(tmp_path):
    rows = lamp_rows().splitlines()
    (tmp_path / "lamp.csv").write_text("\n".join(rows[:5] + rows[6:]))
    notes = []
    assert read_spectra(tmp_path / "lamp.csv", notes).wavelength_nm.size == NM.size - 1
    assert [note.code for note in notes] == ["wavelength-step-uneven"]
    assert "10 nm apart, but 20 nm after 410 nm" in notes[0].message


def test_whatever_happens_to_a_file_it_is_read_or_refused(tmp_path):
    rng = np.random.default_rng(7)
    path = tmp_path / "file"
    seeds = [
        write_table(path, down=down, delimiter=";", comma=True).read_bytes() for down in (0, 1)
    ]
    seeds += [cgats(spectral_fields()).encode(), argyll_spectrum().encode(), spdx().encode()]
    for _ in range(150):
        data = bytearray(seeds[rng.integers(len(seeds))])
        for _ in range(int(rng.integers(1, 6))):
            at = int(rng.integers(len(data)))
            if rng.random() < 0.5:
                data[at : at + 1] = rng.integers(0, 256, int(rng.integers(3)), np.uint8).tobytes()
            else:
                del data[at : at + int(rng.integers(60))]
        path.write_bytes(data)
        try:
            file = read_spectra(path)
        except UsdSkinError as error:
            assert "\n" not in str(error)
        else:
            assert np.isfinite(file.values).all() and file.values.min() >= 0.0
            assert (np.diff(file.wavelength_nm) > 0.0).all()
            assert file.values.shape == (len(file.names), file.wavelength_nm.size)


def test_missing_file_folder_and_huge_file_are_refused(tmp_path):
    with pytest.raises(UsdSkinError, match="is not there"):
        read_spectra(tmp_path / "none.csv")
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsdSkinError, match="a folder of 0 files"):
        read_spectra(tmp_path / "empty")
    with (tmp_path / "huge.csv").open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(UsdSkinError, match="larger than 64 MiB"):
        read_spectra(tmp_path / "huge.csv")


def test_small_negative_readings_become_zero_and_are_told(tmp_path):
    values = chart()
    values[3, 0] = -0.004 * values.max()
    notes = []
    file = read_spectra(write_table(tmp_path / "chart.csv", down=False, values=values), notes)
    assert file.values[3, 0] == 0.0
    assert [note.code for note in notes] == ["negative-readings-zeroed"]
    assert "black 2" in notes[0].message and "380 nm" in notes[0].message


# Quantities


def reflectances_with_peak(path, peak, before=""):
    values = peak * chart() / chart().max()
    file = read_spectra(write_table(path, down=True, values=values, before=before))
    return file, values


@pytest.mark.parametrize(("peak", "divisor"), [(0.9, 1), (1.05, 1), (90.0, 100), (105.0, 100)])
def test_percent_is_told_by_the_largest_value(tmp_path, peak, divisor):
    notes = []
    file, values = reflectances_with_peak(tmp_path / "chart.csv", peak)
    np.testing.assert_allclose(as_reflectances(file, notes), values / divisor, atol=1e-6)
    assert len(notes) == (divisor == 100)


def test_stated_percent_of_a_dark_chart_is_percent(tmp_path):
    file, values = reflectances_with_peak(tmp_path / "chart.csv", 0.8, "# units: %\n")
    np.testing.assert_allclose(as_reflectances(file, []), 0.01 * values, atol=1e-6)


@pytest.mark.parametrize("peak", [1.5, 3000.0])
def test_reflectance_that_is_neither_share_nor_percent_is_refused(tmp_path, peak):
    file, _ = reflectances_with_peak(tmp_path / "chart.csv", peak)
    with pytest.raises(UsdSkinError, match=r"'white 9.5 .* neither a share nor percent"):
        as_reflectances(file, [])


@pytest.mark.parametrize("quantity", ["reflectance", "irradiance"])
def test_other_quantities_are_no_radiance(tmp_path, quantity):
    file, _ = reflectances_with_peak(tmp_path / "chart.csv", 0.5, f"# quantity: {quantity}\n")
    with pytest.raises(UsdSkinError, match=f"holds {quantity}"):
        as_radiances(file, [])


def test_radiance_is_no_reflectance(tmp_path):
    file, values = reflectances_with_peak(
        tmp_path / "chart.csv", 0.5, "# quantity: radiance\n# units: W m^-2 sr^-1 nm^-1\n"
    )
    np.testing.assert_allclose(as_radiances(file, []), values, atol=1e-6)
    with pytest.raises(UsdSkinError, match="holds radiance"):
        as_reflectances(file, [])


def test_unknown_unit_is_refused_and_none_is_relative(tmp_path):
    file, values = reflectances_with_peak(tmp_path / "a.csv", 0.5, "# units: furlongs\n")
    with pytest.raises(UsdSkinError, match="'furlongs'"):
        as_radiances(file, [])
    file, values = reflectances_with_peak(tmp_path / "b.csv", 0.5, "# units: a.u.\n")
    assert not file.is_absolute
    np.testing.assert_allclose(as_radiances(file, []), values, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("W m^-2 sr^-1 nm^-1", (1.0, True)),
        ("W·m⁻²·sr⁻¹·nm⁻¹", (1.0, True)),
        ("[W/(sr m2 nm)]", (1.0, True)),
        ("mW/m²/nm", (1e-3, False)),
        ("µW/cm^2/sr/nm", (1e-2, True)),
        ("W/(m^2*sr*um)", (1e-3, True)),
        ("W sr-1 m-2 m-1", (1e-9, True)),
        ("W", None),
        ("cd/m2", None),
        ("W/m2", None),
        ("W/m3/sr", None),
        ("%", None),
        ("", None),
    ],
)
def test_units_of_spectral_power(text, unit):
    found = radiometric_unit(text)
    assert found == unit if unit is None else found == (pytest.approx(unit[0]), unit[1])


def test_lamp_file_with_several_spectra_is_refused(tmp_path):
    path = write_table(tmp_path / "chart.csv", down=True)
    with pytest.raises(UsdSkinError, match="holds 4 spectra"):
        single_spectrum(path)


def test_large_chart_is_read_in_time(tmp_path):
    """140 patches at 1 nm, both ways, take well under a second each."""
    import time

    nm = np.arange(360, 781)
    values = np.random.default_rng(1).uniform(0.1, 0.9, (140, nm.size))
    rows = ["name," + ",".join(map(str, nm))]
    rows += [f"P{i}," + ",".join(f"{v:.5f}" for v in row) for i, row in enumerate(values)]
    (tmp_path / "chart.csv").write_text("\n".join(rows))
    start = time.perf_counter()
    file = read_spectra(tmp_path / "chart.csv")
    assert time.perf_counter() - start < 3.0
    np.testing.assert_allclose(file.values, values, atol=1e-5)
