"""Text from files, made safe for display.

A character that would move a terminal's cursor or colour it is replaced by its code.
"""

import unicodedata

__all__ = ["visible"]


def visible(text: str) -> str:
    """Replace control and formatting characters by escapes, such as ``\\x1b``.

    Line feeds are kept.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        each.encode("unicode_escape").decode()
        if unicodedata.category(each) in ("Cc", "Cf", "Cs")
        else each
        for each in text
    ).replace("\\n", "\n")
