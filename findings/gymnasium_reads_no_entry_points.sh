#!/usr/bin/env bash
# gymnasium 1.4.0, entry points of other packages (gymnasium 0.29.1 for comparison).
# Guess: a package that declares an entry point in the group gymnasium.envs has its environments
#   registered by `import gymnasium`, as in its predecessor gym and in gymnasium 0.29.
# Seen: 1.4.0 does not look at the group, and says nothing: make() raises NamespaceNotFound. 0.29.1
#   calls the entry point.
# Do: name the module in the identifier, make("package.module:namespace/Name-v0"). The module must be
#   one that registers when it is imported and that nothing has imported before.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

registered() {  # prints whether an installed package's environment is known to a version of gymnasium
  python3 -m venv "env-$1"
  "env-$1/bin/pip" install --quiet "gymnasium==$1" numpy==1.26.4
  site=$("env-$1/bin/python" -c 'import site; print(site.getsitepackages()[0])')
  cat > "$site/plant.py" <<'PY'
from gymnasium.envs.registration import register


def register_environments():
    register("lab/Plant-v0", entry_point="gymnasium.envs.classic_control.cartpole:CartPoleEnv")
PY
  mkdir "$site/plant-1.0.dist-info"
  printf 'Metadata-Version: 2.1\nName: plant\nVersion: 1.0\n' > "$site/plant-1.0.dist-info/METADATA"
  printf '[gymnasium.envs]\n__root__ = plant:register_environments\n' \
    > "$site/plant-1.0.dist-info/entry_points.txt"
  "env-$1/bin/python" - <<'PY'
import gymnasium
from importlib.metadata import entry_points

assert [each.value for each in entry_points(group="gymnasium.envs")] == ["plant:register_environments"]
try:
    gymnasium.make("lab/Plant-v0")
    print("made")
except gymnasium.error.NamespaceNotFound:
    print("NamespaceNotFound")
PY
}

new=$(registered 1.4.0)
old=$(registered 0.29.1)
echo "gymnasium 1.4.0: $new; 0.29.1: $old"
[ "$new" = NamespaceNotFound ] && [ "$old" = made ]
