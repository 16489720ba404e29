"""Patient data of a DICOM header reach no file, output or cache of a run."""

import base64
import re
import zlib

import image_writers as write
import numpy as np
import pytest

SECRETS = (
    "Quillfeather",
    "Aurelia",
    "19481103",
    "PID-774411",
    "ACC-90817263",
    "Saint Elsewhere",
    "Drblackwood",
)
UIDS = ("1.2.826.0.1.3680043.9.77.1", "1.2.826.0.1.3680043.9.77.2")
PATIENT = [
    (0x08, 0x20, "DA", "19481103"),
    (0x08, 0x50, "SH", "ACC-90817263"),
    (0x08, 0x80, "LO", "Saint Elsewhere"),
    (0x08, 0x90, "PN", "Drblackwood^A"),
    (0x08, 0x103E, "LO", "Thorax of Quillfeather"),
    (0x10, 0x10, "PN", "Quillfeather^Aurelia"),
    (0x10, 0x20, "LO", "PID-774411"),
    (0x10, 0x30, "DA", "19481103"),
    (0x20, 0x10, "SH", "PID-774411"),
]
NAMES = "Quillfeather_Aurelia_19481103_{:03d}.dcm"
RUN = ("run", "milling", "--set", "anatomy.file=scan", "--set", "anatomy.threshold=500")
SHORT = ("--set", "voxels.spacing_mm=0.5", "--set", "duration_s=0.4", "--out", "out")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_block(folder, **options):
    """A block of 20 x 12 x 6 mm with a header that names its patient everywhere."""
    values = np.full((40, 24, 12), 2424, np.uint16)
    fields = {"patient": PATIENT, "series": UIDS[0], "name": NAMES, **options}
    write.write_dicom(folder / "scan", values, 0.5 * np.eye(3), (0.0, 0.0, 0.0), **fields)


def require_none(sentence):
    """No secret in some bytes, in the codings that files have."""
    for secret in (*SECRETS, *UIDS):
        for coding in ("utf-8", "utf-16-le"):
            assert secret.lower().encode(coding) not in sentence.lower(), secret


@pytest.mark.slow
def test_a_run_writes_nothing_of_the_patient(command, here, monkeypatch):
    monkeypatch.setenv("TISSUE_CACHE", str(here / "cache"))
    write_block(here)
    code, out, error = command(*RUN, *SHORT)
    assert code == 0, error
    require_none((out + error).encode())
    written = [
        file for folder in ("out", "cache") for file in (here / folder).rglob("*") if file.is_file()
    ]
    assert any(file.suffix == ".png" for file in written) and any(
        file.name == "summary.json" for file in written
    )
    for file in written:
        require_none(file.name.encode() + file.read_bytes())
    assert "scan" in (here / "out" / "scene.toml").read_text()  # the folder's name is the user's


def within(page):
    """A page, and what its texts in base64 hold: arrays, unpacked where they are packed."""
    yield page
    for found in re.finditer(rb"[A-Za-z0-9+/]{64,}={0,2}", page):
        text = found[0][: len(found[0]) // 4 * 4]
        held = base64.b64decode(text)
        yield held
        for bits in (zlib.MAX_WBITS, 16 + zlib.MAX_WBITS, -zlib.MAX_WBITS):
            unpacked = zlib.decompressobj(bits)
            try:
                yield unpacked.decompress(held)
            except zlib.error:
                continue


@pytest.mark.slow
def test_a_report_holds_nothing_of_the_patient(command, here, monkeypatch):
    """Neither in its text nor in its arrays, and no folder above the scan."""
    pytest.importorskip("trame_vtk")
    monkeypatch.setenv("TISSUE_CACHE", str(here / "cache"))
    write_block(here)
    assert command(*RUN, *SHORT)[0] == 0
    code, out, error = command("report", "out")
    assert code == 0, error
    require_none((out + error).encode())
    page = (here / "out" / "report.html").read_bytes()
    parts = list(within(page))
    assert max(map(len, parts[1:])) > 10_000  # arrays of the bone and of the trace
    for part in parts:
        require_none(part)
        assert str(here).encode() not in part  # folders may be named after a patient
    assert b"scan: (40, 24, 12) voxels" in page


def broken(kind, folder):
    files = sorted((folder / "scan").iterdir())
    if kind == "missing":
        files[5].unlink()
    elif kind == "cut":
        files[5].write_bytes(files[5].read_bytes()[:-100])
    elif kind == "cut in the header":
        files[5].write_bytes(files[5].read_bytes()[:400])
    elif kind == "text":
        files[5].write_text("Quillfeather")
    elif kind == "damaged number":  # a position that quotes the patient
        files[5].write_bytes(files[5].read_bytes().replace(b"0\\0\\2.5 ", b"Quillfe "))


@pytest.mark.parametrize("kind", ["missing", "cut", "cut in the header", "text", "damaged number"])
def test_a_broken_series_names_no_patient(refused, here, kind, recwarn):
    write_block(here)
    broken(kind, here)
    sentence = refused(*RUN)
    assert "in scan" in sentence
    require_none(sentence.encode())
    for warning in recwarn:
        require_none(str(warning.message).encode())


def test_several_series_are_named_by_number_and_slices(refused, here):
    write_block(here, each=lambda k: {"series": UIDS[k % 2], "series_number": 7 + k % 2})
    sentence = refused(*RUN)
    assert "got 2 in scan: number 7 with 6 slices and number 8 with 6 slices" in sentence
    require_none(sentence.encode())
