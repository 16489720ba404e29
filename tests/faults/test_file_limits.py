"""Files that state or inflate to more than the memory, and paths that are not files.

They are refused before anything is decoded.
"""

import gzip
import os
import struct
import sys
import zlib

import image_writers as write
import numpy as np
import pytest
from fuzz_files import Reading

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="limits of the address space"
)

ADDRESS_SPACE_GB = 8.0
"""Of the reading process: libraries map 3 GB, a claim of 16 GB and more does not fit."""
BOMB_GB, SMALLER_GB = 0.016, 0.01
"""Decoded size of files that inflate to what they state, and the limit that they exceed."""
AXES, ORIGIN = np.eye(3), (0.0, 0.0, 0.0)
FEW = np.ones((4, 3, 2), dtype=np.int16)


@pytest.fixture(scope="module")
def reading():
    child = Reading(longest_s=60.0, address_space_GB=ADDRESS_SPACE_GB)
    yield child
    child.close()


def nrrd(path, **fields):
    write.write_nrrd(path, FEW, AXES, ORIGIN, **fields)


def npz(path):
    """An archive whose one array states 80 GB and holds nothing."""
    import zipfile

    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000,), }"
    head += b" " * (-(len(head) + 11) % 64) + b"\n"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("time_s.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head)


def hdf5(path):
    """A chunked dataset of 800 GB of which no chunk was ever written."""
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("time_s", shape=(10**11,), dtype="f8", chunks=(1 << 16,))


def dicom(path):
    """Two slices of 60000 x 60000 pixels in RLE, of which the pixels are missing."""
    path.mkdir()
    parts = struct.pack("<HH2sHI", 0x7FE0, 0x10, b"OB", 0, 0xFFFFFFFF) + struct.pack(
        "<HHI", 0xFFFE, 0xE000, 0
    )
    parts += (
        struct.pack("<HHI", 0xFFFE, 0xE000, 64) + bytes(64) + struct.pack("<HHI", 0xFFFE, 0xE0DD, 0)
    )
    fields = {
        "rows": 60000,
        "columns": 60000,
        "syntax": "1.2.840.10008.1.2.5",
        "leave_out": [(0x7FE0, 0x10)],
    }
    for k in range(2):
        head = write.dicom_bytes(
            FEW[:, :, 0].astype(np.uint16),
            (0.0, 0.0, k),
            AXES[0],
            AXES[1],
            (1.0, 1.0),
            number=k + 1,
            **fields,
        )
        (path / f"{k}.dcm").write_bytes(head + parts)


CLAIMS = {
    "a.nrrd": ("image", lambda p: nrrd(p, sizes="4000 4000 600")),
    "b.nrrd": ("image", lambda p: nrrd(p, sizes="4000 4000 600", encoding="gzip")),
    "e.nhdr": ("image", lambda p: nrrd(p, sizes="4000 4000 600", data_file="e.raw")),
    "f.nhdr": ("image", lambda p: nrrd(p, sizes="4000 4000 600", data_file="f.raw 1 1 1")),
    "g.nii": ("image", lambda p: write.write_nifti(p, FEW, AXES, ORIGIN, dim=(3, 4000, 4000, 600))),
    "h.nii.gz": (
        "image",
        lambda p: write.write_nifti(p, FEW, AXES, ORIGIN, dim=(3, 4000, 4000, 600)),
    ),
    "i.mha": ("image", lambda p: write.write_meta(p, FEW, AXES, ORIGIN, DimSize="4000 4000 600")),
    "j.mhd": (
        "image",
        lambda p: write.write_meta(p, FEW, AXES, ORIGIN, compressed=True, DimSize="4000 4000 600"),
    ),
    "dicom": ("image", dicom),
    "l.nrrd": ("labels", lambda p: nrrd(p, sizes="4000 4000 600", encoding="gzip")),
    "m.npz": ("log", npz),
    "n.npz": ("predictor", npz),
    "o.h5": ("log", hdf5),
    "s.ply": (
        "surface",
        lambda p: p.write_text(
            "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float "
            "x\nproperty float y\n"
            "property float z\nelement face 4000000000\nproperty list uchar int "
            "vertex_indices\nend_header\n0000"
        ),
    ),
    "t.msh": (
        "tets",
        lambda p: p.write_text(
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4000000000\n1 0 0 0\n"
        ),
    ),
}


@pytest.mark.parametrize("name", CLAIMS)
def test_a_small_file_that_states_much_is_refused(tmp_path, reading, name):
    reader, make = CLAIMS[name]
    make(tmp_path / name)
    assert sum(file.stat().st_size for file in tmp_path.rglob("*") if file.is_file()) < 20_000
    outcome, message = reading.read(reader, tmp_path / name)
    assert outcome == "refused" and message.count("\n") == 0, message
    if reader == "image":  # by the size that the header states, not by an allocation that failed
        assert "its header states" in message or "GB of memory" in message, message


def zeros_nifti(path):
    values = np.zeros((1000, 1000, 8), dtype=np.uint16)
    path.write_bytes(gzip.compress(write.nifti_bytes(values, AXES, ORIGIN), 1))


def zeros_nrrd(path):
    write.write_nrrd(
        path, np.zeros((1000, 1000, 8), dtype=np.uint16), AXES, ORIGIN, encoding="gzip"
    )


def zeros_h5(path):
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset(
            "time_s", data=np.zeros(2_000_000), chunks=(1_000_000,), compression="gzip"
        )


def zeros_parquet(path):
    import pyarrow
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table({"time_s": np.zeros(2_000_000)}), path)


def zeros_dicom(path):
    """A deflated slice of which an element holds 16 MB of zeros."""
    plane = np.zeros((4, 3), dtype=np.uint16)
    whole = write.dicom_bytes(
        plane, ORIGIN, AXES[0], AXES[1], (1.0, 1.0), syntax="1.2.840.10008.1.2.1.99"
    )
    start = 144 + struct.unpack_from("<I", whole, 140)[0]
    more = struct.pack("<HH2sHI", 0x7FE1, 0x1001, b"OB", 0, 16_000_000) + bytes(16_000_000)
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    path.mkdir()
    (path / "0.dcm").write_bytes(
        whole[:start] + deflate.compress(whole[start:] + more) + deflate.flush()
    )


def zeros_png(path):
    from PIL import Image

    Image.fromarray(np.zeros((4000, 4000), dtype=np.uint8)).save(path)


BOMBS = {
    "a.nii.gz": ("image", zeros_nifti),
    "b.nrrd": ("image", zeros_nrrd),
    "c.npz": ("log", lambda p: np.savez_compressed(p, time_s=np.zeros(2_000_000))),
    "d.h5": ("log", zeros_h5),
    "e.parquet": ("log", zeros_parquet),
    "dicom": ("image", zeros_dicom),
    "f.png": ("image", zeros_png),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_file_that_inflates_beyond_the_limit_is_refused(tmp_path, reading, name):
    reader, make = BOMBS[name]
    make(tmp_path / name)
    stored = sum(file.stat().st_size for file in tmp_path.rglob("*") if file.is_file())
    assert stored < 0.02e9 * BOMB_GB
    outcome, message = reading.read(reader, tmp_path / name, max_memory_GB=SMALLER_GB)
    assert (
        outcome == "refused"
        and "--max-memory-GB" in message
        and f"{SMALLER_GB:g} GB of memory" in message
    ), message


SUFFIXES = {
    "image": ("a.nrrd", "a.nhdr", "a.nii", "a.nii.gz", "a.mha", "a.vti", "a.tif", "a.png"),
    "labels": ("a.nrrd", "a.nii.gz"),
    "surface": ("a.stl", "a.ply", "a.obj", "a.vtp"),
    "tets": ("a.msh", "a.vtu"),
    "log": ("a.csv", "a.npz", "a.mat", "a.h5", "a.parquet"),
    "poses": ("a.csv", "a.hdf5"),
    "toolpath": ("a.csv", "a.ngc", "a.mrk.json"),
    "scene": ("a.toml",),
    "materials": ("a.toml",),
    "predictor": ("a.npz",),
    "observer": ("a.json",),
    "trials": ("a.jsonl",),
}


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_only_regular_files_are_read(tmp_path, reading, kind):
    for reader, names in SUFFIXES.items():
        for name in names:
            path = tmp_path / reader / name
            path.parent.mkdir(exist_ok=True)
            if kind == "pipe":
                os.mkfifo(path)
            else:
                path.symlink_to("/dev/zero")
            outcome, message = reading.read(reader, path)
            assert outcome == "refused", f"{reader} of {name}: {outcome} {message}"


@pytest.mark.parametrize(
    "name", ["voxels.raw", "/dev/zero", "voxels%d.raw 0 0 1", "LIST\nvoxels.raw"]
)
def test_the_voxels_of_a_header_lie_in_regular_files(tmp_path, reading, name):
    os.mkfifo(tmp_path / "voxels.raw")
    os.mkfifo(tmp_path / "voxels0.raw")
    header = write.nrrd_header(FEW, AXES, ORIGIN, data_file=name)
    (tmp_path / "image.nhdr").write_text(header)
    assert reading.read("image", tmp_path / "image.nhdr")[0] == "refused"
