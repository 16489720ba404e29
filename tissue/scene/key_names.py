"""Refusals of functions below, in the words of a scene: its keys and its units."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from meshes.base.errors import InputError

__all__ = ["FILE_WORDS", "in_scene_words", "scene_keys"]

FILE_WORDS = ("file", "surface", "vertices", "faces", "triangles", "cells", "nodes", "labels")
"""What functions that read a file of anatomy call it or what it holds."""
NUMBER = r"(?<![\w.+-])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.])"


@contextmanager
def scene_keys(names: Mapping[str, str]) -> Iterator[None]:
    """Let a refusal name the scene's key: ``names`` holds it by the words with which a refusal begins."""
    try:
        yield
    except InputError as error:
        raise InputError(in_scene_words(str(error), names)) from error


def in_scene_words(message: str, names: Mapping[str, str]) -> str:
    """A refusal with the scene's key, and in millimetres where it has metres.

    A refusal of an argument in metres has all of its lengths in them; elsewhere a length is a number before " m".
    """
    for words, key in sorted(names.items(), key=lambda item: -len(item[0])):
        if not re.match(rf"{re.escape(words)}(?![\w.])", message):
            continue
        argument = words.split(" ", 1)[0]
        if argument.endswith("_m") and " mm" not in message:
            message = re.sub(rf"{NUMBER}(?! times)( m\b)?", _millimetres, message)
        message = key + message.removeprefix(words)
        if "_" not in argument:
            return message  # a plain word, which may have its plain meaning further on
        return re.sub(rf"(?<![\w.]){re.escape(argument)}(?!\w)", key.split(" ", 1)[0], message)
    return message


def _millimetres(found: re.Match[str]) -> str:
    """A length in metres as one in millimetres, with its unit where it had one."""
    return f"{1e3 * float(found[0].removesuffix(' m')):.4g}" + (" mm" if found[1] else "")
