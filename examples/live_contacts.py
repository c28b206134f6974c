# %% [markdown]
"""Where does the rod touch, while it touches?

Poses and wrenches come as datagrams by UDP, one row each, as text: t, x, y, z, qw, qx, qy, qz, fx, fy, fz, mx, my, mz, in SI
units and in the clamp's frame.  Each row that touches gives a line with the contact, and what it is uncertain by.  For a serial
port put `serial.Serial(port, 115200)` of pyserial in the place of the socket, and its `readline()` in that of `recv`.

    python examples/live_contacts.py RIG.toml [--port 5005]
    python examples/live_contacts.py

RIG.toml is a calibration by `scan3d calibrate`, or the TOML file of a recording.  Without it the script sends a simulated scan
of an egg to itself.  In a browser the page whose address is printed first shows contacts and rod while they move.
"""

import socket
import sys
import threading
import time
from pathlib import Path

import numpy as np

import scan3d

HOST, PORT = "127.0.0.1", 5005
MESHES = Path(__file__).resolve().parents[1] / "meshes"


# %% A rig that sends its rows
def send(recording: scan3d.Recording, port: int, rate_hz: float = 500.0) -> None:
    """Send the rows of a six-axis recording, one datagram each, and an empty one at the end."""
    rows = np.hstack([recording.position_m, recording.quaternion, *recording.wrench()])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for k, row in enumerate(rows):
            sender.sendto(",".join(map(repr, [k / rate_hz, *row.tolist()])).encode(), (HOST, port))
            time.sleep(1 / rate_hz)
        sender.sendto(b"", (HOST, port))


# %% Rows come in, contacts go out
def listen(live: scan3d.Live, receiver: socket.socket) -> None:
    """Print and show the contacts of the rows that arrive, until an empty datagram does."""
    with scan3d.LivePage(live) as page:
        print(page.url)
        while row := receiver.recv(1024):
            t, *values = map(float, row.split(b","))
            contact = live.push(t, values[:3], values[3:7], values[7:])
            if contact is not None:
                x, y, z = contact.point
                sd = np.sqrt(np.linalg.eigvalsh(contact.covariance)[-1])
                print(f"{t:8.3f} s  ({x:7.3f}, {y:7.3f}, {z:7.3f}) mm ± {sd:.3f}  {contact.force_N * 1e3:6.1f} mN")


def main(words: list[str]) -> scan3d.Live:
    port = int(words[words.index("--port") + 1]) if "--port" in words else PORT
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        receiver.settimeout(60.0)
        if words and not words[0].startswith("--"):
            receiver.bind((HOST, port))
            live = scan3d.Live(words[0], unit="mm")
            listen(live, receiver)
            return live
        receiver.bind((HOST, 0))  # any that is free
        plan = scan3d.Plan(model="spatial", slices=4, sweeps=4, samples=48, noise=1e-4)
        recording = scan3d.simulate(scan3d.load_mesh(MESHES / "egg.stl"), plan)
        live = scan3d.Live(recording)
        rig = threading.Thread(target=send, args=(recording, receiver.getsockname()[1]))
        rig.start()
        listen(live, receiver)
        rig.join()
        print(f"{len(live.cloud)} of {len(live.contacts)} contacts are left in the cloud of {len(live.recording)} rows")
        return live


if __name__ == "__main__":
    main(sys.argv[1:])
