"""OpenIGTLink messages against the published vectors, byte for byte. Foreign bytes are refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from tissue.links import igtl_messages as igtl
from tissue.links.igtl_messages import LONG, IgtlError, crc64

HELD = json.loads((Path(__file__).parents[2] / "fixtures" / "igtl_vectors.json").read_text("utf-8"))
VECTORS, REFUSED = (
    {name: bytes.fromhex(text) for name, text in HELD[kind].items()}
    for kind in ("messages", "refused")
)
SENT = {"name": "DeviceName", "time_s": 0x499602D4 / 2**32}
POSE = np.array(
    [
        [-0.954892, -0.196632, 0.222525, 46.0531],
        [0.196632, 0.142857, 0.970014, 19.4709],
        [-0.222525, 0.970014, -0.0977491, 46.0531],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
CUBE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
SIDES = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
PIXELS = np.frombuffer(VECTORS["image"][-2500:], dtype=np.uint8).reshape((50, 50, 1), order="F")
FIRST = np.array(POSE)
FIRST[:3, 3] -= POSE[:3, :3] @ [24.5, 24.5, 0.0]
AGES = {"First patient age": "22", "Second patient age": "25"}


def parsed(message):
    """Header and content of a whole message."""
    header = igtl.parse_header(message)
    return header, igtl.content_of(header, message[igtl.HEADER_BYTES :])


@pytest.mark.parametrize(
    ("vector", "kind", "body", "more"),
    [
        ("transform", "TRANSFORM", igtl.transform_body(POSE), {}),
        (
            "transformFormat2",
            "TRANSFORM",
            igtl.transform_body(POSE),
            {"metadata": AGES, "number": 1},
        ),
        (
            "status",
            "STATUS",
            igtl.status_body(15, "Actuator A is disabled.", subcode=10, name="ACTUATOR_DISABLED"),
            {},
        ),
        ("string", "STRING", igtl.string_body("Welcome to OpenIGTLink"), {}),
        (
            "sensor",
            "SENSOR",
            igtl.sensor_body(
                [123456.78, 12345.678, 1234.5678, 123.45678, 12.345678, 1.2345678],
                0x00443E0000000000,
            ),
            {},
        ),
        ("ndarray", "NDARRAY", igtl.ndarray_body(np.arange(60.0).reshape(5, 4, 3)), {}),
        (
            "polydata",
            "POLYDATA",
            igtl.polydata_body(CUBE, SIDES, scalars={"attr": np.arange(8.0)}),
            {},
        ),
        ("image", "IMAGE", igtl.image_body(PIXELS, FIRST), {}),
    ],
)
def test_a_message_is_the_published_one_byte_for_byte(vector, kind, body, more):
    assert igtl.packed(kind, body=body, **SENT, **more) == VECTORS[vector]


def test_headers_of_both_versions_are_read():
    for name, version in (("transform", 1), ("transformFormat2", 2)):
        header, content = parsed(VECTORS[name])
        assert (header.version, header.kind, header.name) == (version, "TRANSFORM", "DeviceName")
        assert header.time_s == SENT["time_s"]
        np.testing.assert_array_equal(
            igtl.parse_transform(content)[:3], POSE[:3].astype(np.float32)
        )


@pytest.mark.parametrize("size", [0, 1, LONG - 1, LONG, LONG + 1, 3 * LONG + 4097])
def test_the_checksum_of_a_long_body_is_that_of_its_bytes_one_by_one(size):
    body, value = np.random.default_rng(size).bytes(size), 0
    for byte in body:
        value ^= byte << 56
        for _ in range(8):
            value = ((value << 1) ^ (0x42F0E1EBA9EA3693 if value >> 63 else 0)) & (2**64 - 1)
    assert crc64(body) == value


@pytest.mark.parametrize(
    ("vector", "problem"),
    [
        ("crc_mismatch", "checksum does not match its body"),
        ("version_zero", "a header of version 0"),
        ("version_future", "a header of version 99"),
        ("ext_header_size_below_minimum", "sizes do not match its message"),
        ("ext_header_size_exceeds_body", "sizes do not match its message"),
        ("region_overflow", "sizes do not match its message"),
        ("transform_body_47", "a TRANSFORM of 47 bytes instead of 48"),
        ("transform_body_49", "a TRANSFORM of 49 bytes instead of 48"),
    ],
)
def test_a_published_faulty_message_is_refused(vector, problem):
    with pytest.raises(IgtlError, match=problem):
        igtl.parse_transform(parsed(REFUSED[vector])[1])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_transform_that_is_not_finite_is_refused(value):
    with pytest.raises(IgtlError, match="not finite"):
        igtl.parse_transform(igtl.transform_body(np.full((4, 4), value)))


def test_texts_beyond_ascii_are_utf_8_and_whole_characters():
    assert igtl.string_body("1 µN").hex() == "006a0005" + "1 µN".encode().hex()
    cut = igtl.string_body("µ" * 40_000)
    assert cut[2:4] == (65534).to_bytes(2, "big") and len(cut) == 4 + 65534


def test_an_image_lies_with_its_middle_where_its_matrix_puts_it():
    matrix = np.array(
        [[0.0, 2.0, 0.0, 5.0], [-1.0, 0.0, 0.0, 7.0], [0.0, 0.0, 3.0, -4.0], [0.0, 0.0, 0.0, 1.0]]
    )
    voxels = np.arange(24, dtype=np.uint16).reshape(2, 3, 4)
    body = igtl.image_body(voxels, matrix)
    placed = np.frombuffer(body[12:60], ">f4").reshape(4, 3)
    np.testing.assert_allclose(placed[:3].T, matrix[:3, :3])
    np.testing.assert_allclose(placed[3], matrix[:3] @ [0.5, 1.0, 1.5, 1.0])
    # The first index is fastest: pixel (1, 0, 0) comes second.
    np.testing.assert_array_equal(
        np.frombuffer(body[72:], "<u2")[:2], [voxels[0, 0, 0], voxels[1, 0, 0]]
    )
