#!/usr/bin/env bash
# Run once, when the image is built: brings its own Python, as the image's may be older than ours.
set -e
export UV_PYTHON_INSTALL_DIR=/opt/python
python3 -m pip install --break-system-packages uv 2>/dev/null || python3 -m pip install uv
python3 -m uv venv --python 3.12 /opt/ballplate
python3 -m uv pip install --python /opt/ballplate @REQUIREMENT@
