"""Lists of words for messages."""

from collections.abc import Iterable


def word_list(words: Iterable[str], last: str = "and") -> str:
    """Join words to a list such as "a, b and c"; `last` comes before the last word."""
    *first, end = list(words) or [""]
    return f"{', '.join(first)} {last} {end}" if first else end
