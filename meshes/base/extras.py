"""Commands that install optional packages."""

import re
from importlib.metadata import PackageNotFoundError, requires


def install_command(extra: str) -> str:
    """Return the pip command that installs the packages of an optional extra of this library.

    The command lists the packages by name. It therefore works for a source checkout and for a
    released version.
    """
    try:
        listed = requires("tissue-sim") or []
    except PackageNotFoundError:
        listed = []
    mark = re.compile(rf"extra == ['\"]{re.escape(extra)}['\"]")
    found = [each.partition(";")[0].strip() for each in listed if mark.search(each)]
    if not found:
        found = [f"tissue-sim[{extra}]"]
    quoted = " ".join(f'"{each}"' for each in found)
    return f"pip install {quoted}"
