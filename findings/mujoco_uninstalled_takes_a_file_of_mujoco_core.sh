#!/usr/bin/env bash
# mujoco 4.0.0 and mujoco-core 4.0.0, the package that it requires.
# Guess: mujoco can be removed from an environment, and mujoco-core, which has the simulation, goes on working.
# Seen: both wheels have the file mujoco/__init__.py. Removing mujoco removes it; `import mujoco` then gives an
#   empty namespace package, without an error, and the first use of a name fails.
# Do: require mujoco-core alone from the beginning, or reinstall mujoco-core after mujoco was removed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet mujoco==4.0.0 mujoco-core==4.0.0 mujoco-studio==4.0.0 numpy==2.4.6
owners=$(grep -l '^mujoco/__init__.py,' env/lib/python3*/site-packages/*.dist-info/RECORD | wc -l)
env/bin/python -c 'import mujoco; print("mujoco", mujoco.__version__); mujoco.MjModel'
env/bin/pip uninstall --quiet --yes mujoco
after=$(env/bin/python -c 'import mujoco; print(mujoco.__file__, hasattr(mujoco, "MjModel"))')
echo "owners of mujoco/__init__.py: $owners; after the removal: $after"
[ "$owners" = 2 ]
[ "$after" = "None False" ]
env/bin/pip install --quiet --force-reinstall --no-deps mujoco-core==4.0.0
env/bin/python -c 'import mujoco; mujoco.MjModel'
