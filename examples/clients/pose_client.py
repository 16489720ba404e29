"""Client of ``tissue serve`` in Python: moves a tool down and prints the force on it.

Run ``tissue serve pedicle`` in one terminal and ``python examples/clients/pose_client.py`` in
another. The client needs only Python. Lengths are in m, in the frame of the scene.
"""

import socket
import struct
import sys
import time
import zlib

HELLO, POSE, WRENCH, HEARTBEAT, BYE, REFUSED = range(1, 7)


class PoseClient:
    """Client that sends a pose and waits for the wrench at this pose.

    Parameters
    ----------
    port
        UDP port of the server on this machine.
    """

    def __init__(self, port: int = 24930) -> None:
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.connect(("127.0.0.1", port))
        self.line.settimeout(0.1)
        self.sent = 0
        self.seen = 0
        waits = False
        while self.ask(HELLO, b"", HELLO) is None:
            if not waits:
                print(f"no server answers at 127.0.0.1:{port} yet", file=sys.stderr, flush=True)
            waits = True
            time.sleep(0.1)

    def move(
        self, tip_m: tuple[float, float, float], quaternion: tuple[float, ...] = (0, 0, 0, 1)
    ) -> tuple[float, ...]:
        """Move the tool to a pose; return force [N] and torque about the tip [N m]."""
        pose = struct.pack("<13dII", *tip_m, *quaternion, *6 * (0.0,), 0, 0)
        while (payload := self.ask(POSE, pose, WRENCH)) is None:
            pass
        return struct.unpack("<6d", payload)

    def ask(self, kind: int, payload: bytes, wanted: int) -> bytes | None:
        """Send a packet; return the payload of the answer, or None if no answer comes in time."""
        self.sent += 1
        self._send(kind, payload)
        while True:
            try:
                data = self.line.recv(2048)
            except (TimeoutError, ConnectionError):
                return None
            body, check = data[:-4], data[-4:]
            if body[:5] != b"TDEV\x01" or struct.pack("<I", zlib.crc32(body)) != check:
                continue
            answer, _, number, echo = struct.unpack_from("<BHII", body, 5)
            if answer == REFUSED:
                raise SystemExit(body[24:].decode())
            self.seen = number
            # The echo is the number of the packet that is answered.
            if answer == wanted and echo == self.sent:
                return body[24:]

    def close(self) -> None:
        """End the session."""
        self.sent += 1
        self._send(BYE, b"")
        self.line.close()

    def _send(self, kind: int, payload: bytes) -> None:
        head = (b"TDEV", 1, kind, len(payload), self.sent, self.seen, time.perf_counter())
        body = struct.pack("<4sBBHIId", *head) + payload
        self.line.send(body + struct.pack("<I", zlib.crc32(body)))


def main(port: int, steps: int) -> None:
    """Move down by 2 micrometres in each step. With steps of 1 ms the speed is 2 mm/s."""
    client = PoseClient(port)
    times = []
    largest = 0.0
    for step in range(steps):
        start = time.perf_counter()
        force = client.move((0.0, 0.0, 1e-3 - 2e-6 * step))
        times.append(time.perf_counter() - start)
        largest = max(largest, force[2])
    client.close()
    times.sort()
    middle, late = 1e6 * times[steps // 2], 1e6 * times[99 * steps // 100]
    print(f"largest force {largest:.2f} N; round trip {middle:.0f} us, 99 % below {late:.0f} us")


if __name__ == "__main__":
    arguments = [int(each) for each in sys.argv[1:]]
    main(*(arguments + [24930, 2000][len(arguments) :]))
