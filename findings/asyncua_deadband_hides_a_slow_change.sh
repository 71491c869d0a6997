#!/usr/bin/env bash
# asyncua 2.1.0, the server, with a subscription that has an absolute deadband (deadband_monitor of its client).
# Guess: a value is reported when it is further from the last reported one than the deadband, as OPC UA part 4 says: the
#   comparison is with the last value that went into the queue.
# Seen: it is compared with the last value that was written, reported or not. A temperature that rises by 0.1 at a time
#   from 0 to 10 with a deadband of 1 is reported once, as 0, and a client that waits for 5 never sees it; a step
#   of 2 is reported. No warning.
# Do: subscribe without a filter and compare in the client.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet asyncua==2.1.0
env/bin/python - <<'PY'
import asyncio
import logging
from importlib.metadata import version

from asyncua import Client, Server

logging.disable()
DEADBAND = 1.0
RAMP = [round(0.1 * step, 1) for step in range(101)]
STEPS = [0.0, 2.0, 2.5, 4.0]


class Reports:
    def __init__(self):
        self.values = []

    def datachange_notification(self, node, value, data):
        self.values.append(value)


def by_the_standard(values):
    """Values that are further than DEADBAND from the last reported one; the first is reported."""
    reported = values[:1]
    for value in values[1:]:
        if abs(value - reported[-1]) > DEADBAND:
            reported.append(value)
    return reported


async def reported(values):
    """Values that reach a client with the deadband and one without."""
    server = Server()
    await server.init()
    server.set_endpoint("opc.tcp://127.0.0.1:0/")
    index = await server.register_namespace("urn:deadband")
    node = await server.nodes.objects.add_variable(index, "temperature", values[0])
    async with server:
        port = server.bserver._server.sockets[0].getsockname()[1]
        async with Client(f"opc.tcp://127.0.0.1:{port}/") as client:
            filtered, plain = Reports(), Reports()
            seen = client.get_node(node.nodeid)
            await (await client.create_subscription(50, filtered)).deadband_monitor(seen, DEADBAND)
            await (await client.create_subscription(50, plain)).subscribe_data_change(seen)
            await asyncio.sleep(0.5)
            for value in values[1:]:
                await node.write_value(value)
                await asyncio.sleep(0.02)
            await asyncio.sleep(1.0)
    return filtered.values, plain.values


async def main():
    print("asyncua", version("asyncua"))
    for name, values, expected in (("ramp", RAMP, [0.0]), ("steps", STEPS, [0.0, 2.0, 4.0])):
        filtered, plain = await reported(values)
        right = by_the_standard(values)
        print(f"{name}: reported {filtered}, by the standard {right}; without a filter {len(plain)} values")
        assert plain == values and filtered == expected
    assert by_the_standard(STEPS) == [0.0, 2.0, 4.0] and len(by_the_standard(RAMP)) == 10


asyncio.run(main())
PY
