#!/usr/bin/env bash
# mcap 1.6.0 (Python), make_reader(...).iter_messages(reverse=True) of a file without chunks, as rosbag2 writes it with
#   noChunking, its preset "fastwrite".
# Guess: the newest message comes first, as in a file with chunks: its page has descending log times.
# Seen: the oldest comes first: for a file without an index of chunks reverse is forgotten. So the last state of a log,
#   next(iter_messages(reverse=True)), is its first one. No warning.
# Do: take the last one of the list in ascending order, or compare the first two log times.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet mcap==1.6.0
env/bin/python - <<'PY'
from importlib.metadata import version

from mcap.reader import make_reader
from mcap.writer import Writer

print("mcap", version("mcap"))
found = {}
for chunks in (True, False):
    with open("log.mcap", "wb") as file:
        writer = Writer(file, use_chunking=chunks)
        writer.start()
        channel = writer.register_channel(topic="/angle", message_encoding="json", schema_id=0)
        for time in range(5):
            writer.add_message(channel, log_time=time, publish_time=time, data=b"{}")
        writer.finish()
    with open("log.mcap", "rb") as file:
        reader = make_reader(file)
        assert reader.get_summary().statistics.message_count == 5
        found[chunks] = [message.log_time for *_, message in reader.iter_messages(reverse=True)]
    print(f"reverse, {'with' if chunks else 'without'} chunks: {found[chunks]}")
assert found[True] == [4, 3, 2, 1, 0]
assert found[False] == [0, 1, 2, 3, 4]
PY
