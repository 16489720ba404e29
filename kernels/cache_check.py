"""Check of Warp's on-disk cache of compiled kernels.

A cache entry is a folder with the files of one compiled module. Warp loads the files without a
check. A full disk or a crash can damage an entry, and every later process would then fail. Entries
are verified when `kernels` is imported. A damaged entry is removed, and Warp compiles it again.
"""

import json
import os
import re
import shutil
import struct
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from uuid import uuid4

MANIFEST = "checksums.json"
"""Name of the file with the checksums of all files that are loaded from a cache entry.

Each checksum is computed when `remove_damaged` finds the file for the first time.
"""
CHECKED = (".o", ".meta", ".ptx", ".cubin")
"""Suffixes of the files that Warp loads, and that are therefore checked."""
BUILDING = re.compile(r"_p\d+_t\d+$")
"""Regular expression for the end of a folder's name while Warp compiles into the folder.

Warp renames the folder when the compilation is complete.
"""
ELF_MAGIC = b"\x7fELF\x02\x01"
"""First bytes of a little-endian 64-bit ELF object."""


def remove_damaged(cache: Path) -> list[str]:
    """Remove damaged entries from a cache of compiled kernels and return their names.

    An entry is damaged if one of its files does not match the file's checksum. A file without a
    checksum is new. A new file is damaged if its structure is incomplete. Otherwise, its checksum
    is recorded. If the cache cannot be read or written, no error is raised, because Warp reports
    the error itself.
    """
    removed = []
    with suppress(OSError):
        for entry in sorted(cache.glob("wp_*")):
            if BUILDING.search(entry.name):
                continue
            if entry.is_dir() and not _is_whole(entry):
                shutil.rmtree(entry, ignore_errors=True)
                removed.append(entry.name)
    return removed


def _is_whole(entry: Path) -> bool:
    """Return whether the files of an entry are undamaged."""
    known = _read_manifest(entry / MANIFEST)
    found: dict[str, str] = {}
    for file in sorted(entry.iterdir()):
        if file.suffix not in CHECKED:
            continue
        if not file.is_file():
            return False
        content = file.read_bytes()
        # 16 bytes: the probability that damage does not change the checksum is 1 in 2^128.
        found[file.name] = blake2b(content, digest_size=16).hexdigest()
        if file.name in known and known[file.name] != found[file.name]:
            return False
        if file.name not in known and not _is_complete(file.suffix, content):
            return False
    if found != known:
        _write_manifest(entry / MANIFEST, found)
    return True


def _is_complete(ending: str, content: bytes) -> bool:
    """Return whether ``content`` is a complete file of the type with the suffix ``ending``."""
    if not content:
        return False
    if ending == ".meta":
        try:
            return isinstance(json.loads(content), dict)
        except ValueError:
            return False
    # A full disk leaves a file of zeros.
    if ending == ".o" and os.name == "posix" and not content.strip(b"\0"):
        return False
    # An ELF header of 64 bits has 64 bytes.
    if content.startswith(ELF_MAGIC) and len(content) >= 64:
        # The section table is the last part of the file. Its offset is at byte 40, the size of a
        # row at byte 58, and the number of rows at byte 60.
        (table_offset,) = struct.unpack_from("<Q", content, 40)
        row_size, row_count = struct.unpack_from("<HH", content, 58)
        return table_offset + row_size * row_count <= len(content)
    return not content.startswith(ELF_MAGIC)


def _read_manifest(file: Path) -> dict[str, str]:
    """Return a dictionary from file name to checksum; empty if the manifest cannot be read."""
    try:
        stored = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return stored if isinstance(stored, dict) else {}


def _write_manifest(file: Path, checksums: dict[str, str]) -> None:
    """Write the checksums atomically, so that another process never reads part of the file."""
    # 48 random bits in the name: two processes never use the same temporary file.
    temporary = file.with_name(f"{uuid4().hex[:12]}-{MANIFEST}")
    with suppress(OSError):
        temporary.write_text(json.dumps(checksums), "utf-8")
        temporary.replace(file)
