"""``tissue devices``."""

from pathlib import Path
from typing import TYPE_CHECKING

from meshes.base.errors import InputError, names_of_caller
from tissue.cli.terminal import ADDRESS, Flag, console, left_out, problems

if TYPE_CHECKING:
    from tissue.haptics.real.adapter import FoundDevice
    from tissue.haptics.real.self_test import SelfTest, Spread


def devices(
    *,
    test: str | None = None,
    address: str | None = None,
    seconds: float | None = None,
    yes: Flag = False,
    out: Path | None = None,
    overwrite: Flag = False,
) -> None:
    """List the haptic devices of this machine with their limits, or test one device.

    The test first measures rate, regularity and latency of the device's position samples, without
    force. Then, after a confirmation by the user, the device pushes the hand with 0.5 N. Not for
    clinical use.

    Parameters
    ----------
    test
        Name of the device to test, such as haply or network.
    address
        Address, as in the key hardware.address of a scene; default the usual address of the device.
    seconds
        Duration of the measurement, in seconds; default 2.
    yes
        Skip the confirmation before the device pushes the hand.
    out
        TOML file to which the measured rate and latency are written. A scene uses these values if
        its key `materials` names this file.
    overwrite
        Replace an existing file.
    """
    if test is None:
        left_out(
            "without --test",
            "name a device by --test",
            address=address,
            seconds=seconds,
            yes=yes,
            out=out,
        )
        left_out("without --out", "remove it", overwrite=overwrite)
        _list()
        return
    if out is None:
        left_out("without --out", "remove it", overwrite=overwrite)
    _test(
        test, address or "", 2.0 if seconds is None else seconds, out, yes=yes, overwrite=overwrite
    )


def _list() -> None:
    from tissue.haptics.real.adapter import devices as found_devices
    from tissue.scene.registry import DEVICES

    with problems.status("looking for devices"):
        found = found_devices()
    here = [each for each in found if not each.problem]
    for each in here:
        console.print(
            f"{each.name:<15} {each.where}  {each.detail}", f"{'':<15} {_limits(each)}", sep="\n"
        )
    if not here:
        console.print("no device is found")
    for each in found:
        if each.problem:
            console.print(f"{each.name:<15} {each.problem}")
    for name in DEVICES:
        if DEVICES[name].make is not None:
            console.print(f"{name:<15} registered; opened in a run of a scene that names it")


def _limits(found: "FoundDevice") -> str:
    limits = found.limits
    if limits is None:
        return "limits are not known"
    torque = f", {limits.torque_limit_Nm:g} N m" if limits.torque_limit_Nm > 0.0 else ", no torque"
    box = " x ".join(f"{1e3 * edge:g}" for edge in limits.workspace_m)
    return (
        f"at most {limits.force_limit_N:g} N{torque}; workspace {box} mm; {limits.rate_Hz:g} "
        "Hz and "
        f"{1e3 * limits.transport_delay_s:g} ms of latency unless measured"
    )


def _test(
    name: str, address: str, seconds: float, out: Path | None, *, yes: bool, overwrite: bool
) -> None:
    from meshes.base.text_tables import unknown_name
    from meshes.base.whole_file import require_new_file
    from tissue.haptics.real.adapter import adapter_class
    from tissue.haptics.real.self_test import BUMP_N, BUMP_S, bump, self_test, write_measured
    from tissue.scene.coupling import Hardware
    from tissue.scene.registry import DEVICES

    known = [each for each in DEVICES if DEVICES[each].has_adapter]
    if name in DEVICES and DEVICES[name].make is not None:
        raise InputError(
            "--test",
            f"name a device that tissue opens itself ({', '.join(known)})",
            f"the registered device {name}",
            f"use it in a run: tissue run SCENE --set device={name}",
        )
    if name not in known:
        raise unknown_name("--test", known, name)
    if out is not None:
        require_new_file(out, overwrite=overwrite)
    with names_of_caller(ADDRESS), adapter_class(name)(Hardware(address=address)) as adapter:
        with problems.status(f"measuring {name} for {seconds:g} s: move the handle"):
            measured = self_test(adapter, seconds=seconds)
        console.print(*_lines(measured), sep="\n")
        if yes or _confirmed(f"{BUMP_N:g} N for {BUMP_S:g} s"):
            pushed = bump(adapter)
            console.print(
                f"push              {BUMP_N:g} N along the device's z: moved "
                f"{1e3 * pushed.along_m:.2f} mm along it, "
                f"{1e3 * pushed.moved_m:.2f} mm in all"
            )
        else:
            console.print("push              not confirmed: left out")
    if out is not None:
        write_measured(out, name, measured)
        console.print(f'written to {out}: use it in a scene by --set materials="{out}"')


def _lines(measured: "SelfTest") -> list[str]:
    from math import isfinite

    def ms(found: "Spread") -> str:
        if not isfinite(found.median_s):
            return "not shown by this device"
        return f"{1e3 * found.median_s:.3f} ms, 99 % {1e3 * found.p99_s:.3f} ms"

    return [
        (
            f"samples           {measured.samples} in {measured.seconds:g} s, "
            f"{measured.rate_Hz:.0f} Hz"
        ),
        (f"interval          {ms(measured.interval)}, max {1e3 * measured.longest_s:.3f} ms"),
        f"calls             {ms(measured.call)}",
        f"round trip        {ms(measured.round_trip)}",
    ]


def _confirmed(push: str) -> bool:
    """Ask the user to confirm that the device may push the hand; return the answer."""
    console.print(
        f"Hold the handle loosely; the device will push with at most {push}. Type push and "
        "Enter to feel it:"
    )
    try:
        return input().strip().lower() == "push"
    except EOFError:
        return False
