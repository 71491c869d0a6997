"""The rigs as environments of Gymnasium: ``ballplate/Track-v0``, ``Hold-v0``, ``Step-v0``.

    import ballplate
    import gymnasium as gym

    env = gym.make("ballplate/Track-v0")
    envs = gym.make_vec("ballplate/Track-v0", num_envs=256, family="uncertain")

Importing this module registers them. ``import ballplate`` does so as soon as gymnasium is loaded,
which itself loads no other package and reads no entry points: the two imports have no order. In a
program without ``import ballplate``, gymnasium imports what stands before a colon, as in
``gym.make("ballplate:ballplate/Track-v0")``.

An environment is a rig of ``ballplate run``: same plant, sensors, limits and noise, so that the
same commands give the same ball path, to the last bit. ``ballplate.gym.environments`` has
what is seen, what an action means, the reward, and the end of an episode.

Needs the extra ``gym``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from twin.base.parts import extra

with extra("gym", "ballplate.gym"):
    from gymnasium.envs.registration import register, registry

if TYPE_CHECKING:
    from ballplate.gym.environments import RigEnv, RigVectorEnv

__all__ = ["ENVIRONMENTS", "RigEnv", "RigVectorEnv"]

ENVIRONMENTS: dict[str, dict[str, Any]] = {
    "ballplate/Track-v0": {"scenario": "circle"},
    "ballplate/Hold-v0": {"scenario": "hold", "family": "placed"},
    "ballplate/Step-v0": {"scenario": "step"},
}
"""Registered environments, with the default arguments of each."""

for _name, _arguments in ENVIRONMENTS.items():
    if _name not in registry:
        register(
            _name,
            entry_point="ballplate.gym.environments:RigEnv",
            vector_entry_point="ballplate.gym.environments:RigVectorEnv",
            kwargs=_arguments,
        )


def __getattr__(name: str) -> Any:
    if name in {"RigEnv", "RigVectorEnv"}:
        return getattr(import_module("ballplate.gym.environments"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
