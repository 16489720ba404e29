"""Image files written byte by byte, so that no reader under test has a hand in what they say.

Voxel (i, j, k) of `values` lies at `origin + axes @ (i, j, k)` [mm, LPS]; the columns of `axes` are the steps from one
voxel to the next along each axis of the array, direction times spacing.
"""

import gzip
import struct
import zlib

import numpy as np

NIFTI_TYPES = {"uint8": 2, "int16": 4, "int32": 8, "float32": 16, "float64": 64, "uint16": 512}
META_TYPES = {"uint8": "MET_UCHAR", "int16": "MET_SHORT", "uint16": "MET_USHORT", "float32": "MET_FLOAT"}
NRRD_TYPES = {"uint8": "uint8", "int16": "int16", "uint16": "uint16", "int32": "int32", "float32": "float"}
LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0])


def nifti_bytes(values, axes, origin, *, slope=1.0, intercept=0.0, units=2, code=1, **fields):
    """NIfTI-1: an affine in RAS. `fields` overwrite header numbers: dim, pixdim, vox_offset, bitpix, datatype, sform."""
    affine = np.column_stack([LPS_TO_RAS @ axes, LPS_TO_RAS @ np.asarray(origin, float)])
    spacing = np.linalg.norm(axes, axis=0)
    dim = fields.get("dim", (values.ndim, *values.shape))
    pixdim = fields.get("pixdim", (1.0, *spacing))
    head = bytearray(352)
    struct.pack_into("<i", head, 0, 348)
    struct.pack_into("<8h", head, 40, *(*dim, *(1,) * (8 - len(dim))))
    struct.pack_into("<h", head, 70, fields.get("datatype", NIFTI_TYPES[values.dtype.name]))
    struct.pack_into("<h", head, 72, fields.get("bitpix", 8 * values.dtype.itemsize))
    struct.pack_into("<8f", head, 76, *(*pixdim, *(1.0,) * (8 - len(pixdim))))
    struct.pack_into("<f", head, 108, fields.get("vox_offset", 352.0))
    struct.pack_into("<ff", head, 112, slope, intercept)
    head[123] = units
    struct.pack_into("<hh", head, 252, 0, code)
    struct.pack_into("<12f", head, 280, *fields.get("sform", affine).ravel())
    head[344:348] = b"n+1\0"
    return bytes(head) + values.astype(values.dtype.newbyteorder("<")).tobytes(order="F")


def set_qform(data, quaternion, offset, code=1):
    """Give a NIfTI-1 header in `data` a quaternion (b, c, d) and an offset, in RAS."""
    struct.pack_into("<h", data, 252, code)
    struct.pack_into("<6f", data, 256, *quaternion, *offset)


def write_nifti(path, values, axes, origin, **options):
    data = nifti_bytes(values, axes, origin, **options)
    path.write_bytes(gzip.compress(data, 1, mtime=0) if path.name.endswith(".gz") else data)


def nrrd_header(values, axes, origin, *, space="left-posterior-superior", encoding="raw", **fields):
    """NRRD 4 header; `fields` overwrite or, where None, leave out lines (underscores for spaces)."""
    flip = {"left-posterior-superior": np.eye(3), "right-anterior-superior": LPS_TO_RAS}.get(space, np.eye(3))

    def vector(v):
        return "(" + ",".join(f"{x:.17g}" for x in v) + ")"

    lines = {
        "type": NRRD_TYPES[values.dtype.name],
        "dimension": str(values.ndim),
        "space": space,
        "sizes": " ".join(map(str, values.shape)),
        "space directions": " ".join(vector(flip @ axes[:, k]) for k in range(3)),
        "kinds": "domain domain domain",
        "endian": "little",
        "encoding": encoding,
        "space origin": vector(flip @ np.asarray(origin, float)),
    }
    lines.update({key.replace("_", " "): value for key, value in fields.items()})
    return "NRRD0004\n" + "".join(f"{key}: {value}\n" for key, value in lines.items() if value is not None)


def write_nrrd(path, values, axes, origin, *, encoding="raw", **options):
    data = values.astype(values.dtype.newbyteorder("<")).tobytes(order="F")
    if encoding == "gzip":
        data = gzip.compress(data, 1, mtime=0)
    header = nrrd_header(values, axes, origin, encoding=encoding, **options)
    if path.suffix == ".nhdr":
        path.write_text(header)
        (path.parent / options["data_file"]).write_bytes(data)
    else:
        path.write_bytes(header.encode() + b"\n" + data)


def write_meta(path, values, axes, origin, *, compressed=False, **fields):
    """MetaImage (`.mhd` with a `.raw` beside it, or `.mha`); `fields` overwrite or, where None, leave out lines."""
    spacing = np.linalg.norm(axes, axis=0)
    raw = "LOCAL" if path.suffix == ".mha" else path.with_suffix(".raw").name
    lines = {
        "ObjectType": "Image",
        "NDims": str(values.ndim),
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "TransformMatrix": " ".join(f"{x:.17g}" for x in (axes / spacing).T.ravel()),
        "Offset": " ".join(f"{x:.17g}" for x in origin),
        "ElementSpacing": " ".join(f"{x:.17g}" for x in spacing),
        "DimSize": " ".join(map(str, values.shape)),
        "ElementType": META_TYPES[values.dtype.name],
        "ElementDataFile": raw,
    }
    if compressed:
        lines["CompressedData"] = "True"
    tail = fields.pop("tail", {})
    data_file = lines.pop("ElementDataFile")
    lines.update(fields)
    lines.update(tail)
    lines["ElementDataFile"] = lines.pop("ElementDataFile", data_file)
    text = "".join(f"{key} = {value}\n" for key, value in lines.items() if value is not None)
    data = values.astype(values.dtype.newbyteorder("<")).tobytes(order="F")
    if compressed:
        data = zlib.compress(data, 1)
    if path.suffix == ".mha":
        path.write_bytes(text.encode() + data)
    else:
        path.write_text(text)
        path.with_suffix(".raw").write_bytes(data)


def write_vti(path, values, axes, origin):
    """VTK image, its points in ASCII."""
    spacing = np.linalg.norm(axes, axis=0)
    extent = " ".join(f"0 {n - 1}" for n in values.shape)

    def text(numbers):
        return " ".join(f"{x:.17g}" for x in numbers)

    kind = {"int16": "Int16", "uint8": "UInt8"}[values.dtype.name]
    path.write_text(
        f"""<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian">
<ImageData WholeExtent="{extent}" Origin="{text(origin)}" Spacing="{text(spacing)}" Direction="{text((axes / spacing).ravel())}">
<Piece Extent="{extent}"><PointData Scalars="grey"><DataArray type="{kind}" Name="grey" format="ascii">
{" ".join(map(str, values.ravel(order="F").tolist()))}
</DataArray></PointData><CellData/></Piece></ImageData></VTKFile>
"""
    )


def element(group, number, kind, value):
    """One data element, explicit little endian."""
    value = value.encode() if isinstance(value, str) else value
    value += (b"\0" if kind == "UI" else b" ") * (len(value) % 2)
    head = struct.pack("<HH", group, number) + kind.encode()
    return head + (struct.pack("<HI", 0, len(value)) if kind == "OW" else struct.pack("<H", len(value))) + value


def dicom_bytes(plane, position, row, column, pixel_mm, *, number=1, syntax="1.2.840.10008.1.2.1", **fields):
    """A CT slice. `plane[i, j]`: `i` along `row`, the direction of growing column numbers, `j` along `column`.

    `fields`: series, series_number, slope, intercept, tilt, padding, orientation, spacing, photometric, samples, bits,
    patient (a list of elements), leave_out (tags), pixels (bytes), rows, columns.
    """
    signed = int(plane.dtype.kind == "i")

    def short(n):
        return struct.pack("<H", n & 0xFFFF)

    def text(numbers):
        return "\\".join(f"{x:.12g}" for x in numbers)

    meta = element(2, 2, "UI", "1.2.840.10008.5.1.4.1.1.2") + element(2, 3, "UI", f"1.2.3.{number}")
    meta += element(2, 0x10, "UI", syntax)
    meta = element(2, 0, "UL", struct.pack("<I", len(meta))) + meta
    elements = [
        (8, 0x16, "UI", "1.2.840.10008.5.1.4.1.1.2"),
        (8, 0x18, "UI", f"1.2.3.{number}"),
        (8, 0x60, "CS", "CT"),
        *fields.get("patient", ()),
        (0x18, 0x50, "DS", "1"),
        (0x18, 0x1120, "DS", f"{fields.get('tilt', 0.0):g}"),
        (0x20, 0xD, "UI", "1.2.3"),
        (0x20, 0xE, "UI", fields.get("series", "1.2.3.4")),
        (0x20, 0x11, "IS", str(fields.get("series_number", 1))),
        (0x20, 0x13, "IS", str(number)),
        (0x20, 0x32, "DS", text(position)),
        (0x20, 0x37, "DS", fields.get("orientation", text([*row, *column]))),
        (0x28, 2, "US", short(fields.get("samples", 1))),
        (0x28, 4, "CS", fields.get("photometric", "MONOCHROME2")),
        (0x28, 0x10, "US", short(fields.get("rows", plane.shape[1]))),
        (0x28, 0x11, "US", short(fields.get("columns", plane.shape[0]))),
        (0x28, 0x30, "DS", fields.get("spacing", text([pixel_mm[1], pixel_mm[0]]))),
        (0x28, 0x100, "US", short(16)),
        (0x28, 0x101, "US", short(16)),
        (0x28, 0x102, "US", short(15)),
        (0x28, 0x103, "US", short(signed)),
        (0x28, 0x120, "SS" if signed else "US", short(fields["padding"]) if "padding" in fields else b""),
        (0x28, 0x1052, "DS", f"{fields.get('intercept', -1024.0):g}"),
        (0x28, 0x1053, "DS", f"{fields.get('slope', 1.0):g}"),
        (0x28, 0x1054, "LO", "HU"),
        (0x7FE0, 0x10, "OW", fields.get("pixels", plane.astype(plane.dtype.newbyteorder("<")).tobytes(order="F"))),
    ]
    left_out = {(0x28, 0x120)} - ({(0x28, 0x120)} if "padding" in fields else set()) | set(fields.get("leave_out", ()))
    kept = sorted((e for e in elements if e[:2] not in left_out), key=lambda e: e[:2])
    return b"\0" * 128 + b"DICM" + meta + b"".join(element(*e) for e in kept)


def write_dicom(folder, values, axes, origin, *, each=None, name="slice{:03d}.dcm", **fields):
    """A series, a file a slice along the last axis; `each(k)` gives fields of slice `k`."""
    folder.mkdir(exist_ok=True)
    spacing = np.linalg.norm(axes, axis=0)
    row, column = axes[:, 0] / spacing[0], axes[:, 1] / spacing[1]
    for k in range(values.shape[2]):
        own = {"position": np.asarray(origin, float) + k * axes[:, 2], **fields, **(each(k) if each else {})}
        data = dicom_bytes(values[:, :, k], own.pop("position"), row, column, spacing[:2], number=k + 1, **own)
        (folder / name.format(k)).write_bytes(data)
