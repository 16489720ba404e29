"""``tissue serve``."""

import signal

from tissue.cli.terminal import Flag, Overrides, Whole, console, left_out, print_notes, problems


def serve(
    scene: str,
    /,
    *,
    set_: Overrides = (),
    address: str | None = None,
    ros2: Flag = False,
    step_ms: Whole = 1,
    reach_mm: float | None = None,
) -> None:
    """Receive poses of the tool from another program, and send back force and torque.

    The other program, such as a robot simulator or a game engine, moves the tool of a scene. For
    each pose that it sends, the tissue is simulated for one step, and the program receives force
    and torque on the tool. The velocity of the tool is computed as change of the pose divided by
    the duration of the step. Ctrl-C ends the server. Not for clinical use.

    Parameters
    ----------
    scene
        Name of a built-in scene, or a TOML file.
    set_
        KEY=VALUE replaces an entry of the scene; may be repeated.
    address
        Address at which poses are received: udp://HOST:PORT or ws://HOST:PORT; default
        udp://127.0.0.1:24930.
    ros2
        Receive poses on the ROS 2 topic /tissue/servo_cp instead of an address.
    step_ms
        Simulated time of a step, in whole milliseconds.
    reach_mm
        Largest distance of the prepared tissue from the path in the scene, in mm; default 2. It is
        measured perpendicular to the axis of the tool. The tissue is prepared down to the deepest
        point of the path.
    """
    from tissue.links.pose_server import serve_network, serve_ros2
    from tissue.objects.loop import Loop
    from tissue.scene.coupling import Hardware
    from tissue.scene.load import load_scene, parse_overrides
    from tissue.system.stopping import signals_handled

    if ros2:
        left_out("with --ros2", "remove it", address=address)
    try:
        # A handler in Python would wait for the end of a native call, such as a factorisation.
        # The preparation writes no output, so SIGTERM may end the process at once.
        with signals_handled((signal.SIGTERM,), signal.SIG_DFL):
            problems.print(f"preparing the tissue of {scene}; clients are answered afterwards")
            with problems.status(f"building {scene}"):
                loaded = load_scene(scene, parse_overrides(set_))
                loop = Loop(loaded, step_ms=step_ms, reach_mm=reach_mm)
    except KeyboardInterrupt as stopped:
        stopped.args = ("stopped before the server was ready",)
        raise
    print_notes()
    for about, note in loop.notes.items():
        console.print(f"{about}: {note}", markup=False)

    def opened(place: str) -> None:
        console.print(f"awaiting poses at {place}; Ctrl-C ends", markup=False)

    try:
        if ros2:
            serve_ros2(loop, opened=opened)
        else:
            serve_network(loop, Hardware(address=address or ""), opened=opened)
    except KeyboardInterrupt:
        console.print(f"served {loop.ticks} ms of simulated time since the last start")
