"""A switch that delays and loses frames, for kernels without netem.

    python3 slow_switch.py DELAY_MS JITTER_MS LOSS_PERCENT PORT...

Makes a tunnel device (TAP) for each port, says "ready", and carries each frame that one sends to all others.
"""

import fcntl
import heapq
import os
import random
import select
import struct
import sys
import time

TUNSETIFF, TAP_WITHOUT_HEADER = 0x400454CA, 0x1002
FRAME_BYTES_MOST = 65536

delay_s, jitter_s = (float(number) / 1000 for number in sys.argv[1:3])
lost = float(sys.argv[3]) / 100
ports = []
for name in sys.argv[4:]:
    port = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(port, TUNSETIFF, struct.pack("16sH22x", name.encode(), TAP_WITHOUT_HEADER))
    ports.append(port)
print("ready", flush=True)

dice = random.Random(1)
on_the_way = []  # (when it arrives, a number that keeps the order, at which port, what)
number = 0
while True:
    wait_s = max(0.0, on_the_way[0][0] - time.monotonic()) if on_the_way else None
    for port in select.select(ports, [], [], wait_s)[0]:
        try:
            frame = os.read(port, FRAME_BYTES_MOST)
        except OSError:
            continue  # the device is down
        if dice.random() < lost:
            continue
        arrives = time.monotonic() + delay_s + dice.uniform(-jitter_s, jitter_s)
        for other in ports:
            if other != port:
                heapq.heappush(on_the_way, (arrives, number, other, frame))
                number += 1
    while on_the_way and on_the_way[0][0] <= time.monotonic():
        _, _, port, frame = heapq.heappop(on_the_way)
        try:
            os.write(port, frame)
        except OSError:
            pass  # the device is down, or its queue full: one more that is lost
