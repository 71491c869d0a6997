"""`twin.sim.plant.model`.

The model file as a file: complete, quiet, named, and what its comments say."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from twin.base.errors import ModelError
from twin.base.shipped import model_path
from twin.sim.plant.fitting import compile_with, fit_parts
from twin.sim.plant.interface import Parts
from twin.sim.plant.model import load_model
from twin.sim.plant.rig_models import differing, fields_of

KINDS = (
    *("bodies", "joints", "geoms", "sites", "cameras", "lights", "textures", "materials"),
    *("pairs", "tendons", "actuators", "sensors", "keys"),
)


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_path(str(model_path()))


@pytest.fixture
def level(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    mujoco.mj_forward(model, data)
    return data


def test_the_model_compiles_and_runs_without_a_warning(tmp_path, monkeypatch):
    heard = []
    before = mujoco.get_mju_user_warning()
    monkeypatch.chdir(tmp_path)
    mujoco.set_mju_user_warning(heard.append)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            model = mujoco.MjModel.from_xml_path(str(model_path()))
            data = mujoco.MjData(model)
            mujoco.mj_step(model, data, 100)
    finally:
        mujoco.set_mju_user_warning(before)
    assert not heard
    assert not any(warning.number for warning in data.warning)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", KINDS)
def test_every_element_has_a_name(kind):
    elements = getattr(mujoco.MjSpec.from_file(str(model_path())), kind)
    assert elements
    assert all(each.name for each in elements)


def test_the_file_needs_no_other_file():
    text = model_path().read_text(encoding="utf-8")
    assert not re.search(r"<include|\bfile=|<mesh|<hfield|<plugin", text)


def test_the_screen_the_joint_and_the_ball_are_the_thesis_ones(model):
    plate, ball = model.geom("plate"), model.body("ball")
    assert 2 * plate.size[:2] == pytest.approx([0.70, 0.395])
    assert plate.pos[2] + plate.size[2] == pytest.approx(0.122)
    assert float(ball.mass[0]) == pytest.approx(0.024)
    assert ball.inertia == pytest.approx([6.4e-6] * 3)
    assert float(model.geom("ball").size[0]) == pytest.approx(0.02)
    for axis in ("phi", "theta"):
        assert np.degrees(model.joint(axis).range) == pytest.approx([-10, 10], abs=1e-4)


def test_the_keyframe_level_is_at_rest(model, level):
    assert np.abs(level.qacc).max() < 1e-4
    assert level.qvel == pytest.approx(np.zeros(model.nv))
    assert level.joint("phi").qpos == level.joint("theta").qpos == 0
    assert level.sensor("ball_position").data[:2] == pytest.approx([0, 0])


@pytest.mark.parametrize("axis", ["phi", "theta"])
def test_a_cam_contact_has_the_stiffness_the_file_states(model, level, axis):
    wheel = model.geom(f"wheel_{axis}").id
    contact = next(c for c in level.contact if wheel in c.geom)
    force = level.sensor(f"wheel_{axis}_force").data[0]
    assert force / -contact.dist == pytest.approx(80e3, rel=5e-3)


def test_wheel_forces_carry_spring_and_weight_about_the_cardan_joint(model, level):
    # moments about the joint, by hand: spring and weight against each wheel at 0.16 m
    weight = 5.5 * 9.81
    phi = (90 * 0.12 - weight * 0.004) / 0.16
    theta = (90 * 0.12 - weight * 0.003) / 0.16
    assert level.sensor("wheel_phi_force").data[0] == pytest.approx(phi, rel=1e-3)
    assert level.sensor("wheel_theta_force").data[0] == pytest.approx(theta, rel=1e-3)


def rates(model):
    """Eigenvalues of the model about level, from its differentiated step."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    size = 2 * model.nv + model.na
    transition = np.zeros((size, size))
    mujoco.mjd_transitionFD(model, data, 1e-7, True, transition, None, None, None)
    eigenvalues = np.linalg.eigvals(transition).astype(complex)
    return np.log(eigenvalues[np.abs(eigenvalues) > 0.1]) / model.opt.timestep


def resonances(model):
    """Frequency in Hz and damping ratio of both swings of the plate."""
    slow = [r for r in rates(model) if 2 * math.pi * 5 < r.imag < 2 * math.pi * 40]
    return sorted((abs(r) / (2 * math.pi), -r.real / abs(r)) for r in slow)


def test_the_plate_rings_between_the_references_and_25_hz_with_little_damping(model):
    fastest_reference = 1.0 / (2 * math.pi)
    found = resonances(model)
    assert len(found) == 2
    for frequency, damping in found:
        assert 30 * fastest_reference < frequency < 25
        assert 0.02 < damping < 0.2


def test_half_the_step_hardly_moves_the_resonances(model, tmp_path):
    text = model_path().read_text(encoding="utf-8")
    finer = tmp_path / "finer.xml"
    finer.write_text(text.replace('timestep="0.001"', 'timestep="0.0005"'), encoding="utf-8")
    for coarse, fine in zip(resonances(model), resonances(load_model(finer)), strict=True):
        assert coarse == pytest.approx(fine, rel=5e-3)


@pytest.mark.parametrize("parts", [Parts(), Parts(preload=60.0, offset=(1e-4, 0.0, 0.0))])
def test_without_what_is_only_seen_it_moves_by_the_same_bits(parts):
    ends = []
    seen, bare = (load_model(parts=parts, drawn=drawn) for drawn in (True, False))
    for model in (seen, bare):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
        data.joint("ball").qvel[:2] = 0.05, -0.03
        for k in range(1000):
            data.ctrl[:] = 1.5 * math.sin(0.006 * k), math.cos(0.01 * k)
            mujoco.mj_step(model, data)
        ends.append(np.concatenate((data.qpos, data.qvel, data.sensordata)))
    assert np.array_equal(*ends)
    assert bare.ngeom < seen.ngeom
    assert bare.nmat == bare.ntex == 0


@pytest.mark.parametrize("axis", ["phi", "theta"])
def test_stiffer_wheels_keep_their_damping_ratio(axis):
    # c / (2 sqrt(k J)) with the same inertia on them: c squared grows as k does
    nominal, stiffer = (
        load_model(parts=parts).pair(f"cam_{axis}").solref
        for parts in (Parts(), Parts(stiffness=160e3))
    )
    stiffness, damping = stiffer / nominal
    assert stiffness == pytest.approx(2, rel=1e-3)
    assert damping**2 == pytest.approx(stiffness)


STANDING = [
    Parts(preload=60.0),
    Parts(mass=0.05, plate_centre=(0.001, 0.002)),
    Parts(level=(0.005, 0.0)),
    Parts(level=(-0.003, 0.004), preload=60.0),
    Parts(level=(0.087, -0.087), mass=0.05, plate_centre=(0.001, 0.002)),
]


@pytest.mark.parametrize("parts", STANDING)
def test_a_balanced_mechanism_stays_level_when_it_is_let_go(parts):
    model = load_model(parts=parts, drawn=False)
    hinges = [model.joint(f"{cam}{axis}") for axis in ("phi", "theta") for cam in ("", "cam_")]
    for hinge in hinges:
        if "cam" not in hinge.name:
            model.dof_damping[hinge.dofadr[0]] = 20.0  # near critical: rests within a few periods
    ball, data = model.joint("ball"), mujoco.MjData(model)
    place, speed = ball.qposadr[0], ball.dofadr[0]
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    for _ in range(round(0.1 / model.opt.timestep)):
        mujoco.mj_step(model, data)
        # the ball does not roll off
        data.qpos[place : place + 2] = data.qvel[speed : speed + 2] = 0.0
        data.qpos[place + 3 : place + 7] = 1.0, 0.0, 0.0, 0.0
        data.qvel[speed + 3 : speed + 6] = 0.0
    assert np.abs(data.qpos[[hinge.qposadr[0] for hinge in hinges]]).max() < 1e-8
    nominal = load_model(drawn=False)
    assert np.abs(model.body_pos - nominal.body_pos).max() > 1e-7


def test_friction_of_the_joints_has_no_part_in_the_balance():
    parts = Parts(level=(-0.003, 0.004), preload=60.0)
    free, held = (load_model(parts=replace(parts, joint_friction=f)) for f in (None, 0.1))
    np.testing.assert_array_equal(held.body_pos, free.body_pos)
    np.testing.assert_array_equal(held.key_act, free.key_act)


@pytest.mark.parametrize("parts", [Parts(preload=5.0), Parts(torque=1.0)])
def test_parts_that_cannot_hold_a_tilted_mechanism_level_are_refused(parts):
    load_model(parts=parts, drawn=False)
    with pytest.raises(ModelError, match="do not come to rest level"):
        load_model(parts=replace(parts, level=(-0.08, 0.08)), drawn=False)


FITTED = [
    Parts(sliding=0.3, spinning=2e-5, torque=1.0, speed=3.0, joint_friction=0.1),
    Parts(stiffness=160e3, damping_ratio=0.2),
    Parts(preload=60.0, level=(0.003, -0.002)),
]
COMPILED = [
    Parts(mass=0.03, radius=0.019, inertia=5e-6, level=(0.003, -0.002)),
    Parts(offset=(1e-4, 0.0, 2e-4), plate_centre=(0.001, 0.002)),
    Parts(oval=2e-4),
]


def bits(model):
    """A model as it would be written to a file."""
    found = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, found)
    return found.tobytes()


@pytest.mark.parametrize("parts", FITTED + COMPILED)
def test_a_mechanism_that_is_kept_is_that_of_a_compile_of_its_own_to_the_last_bit(parts):
    changed = load_model(parts=parts, drawn=False)
    load_model(parts=COMPILED[0], drawn=False)
    spec = mujoco.MjSpec.from_file(str(model_path()))
    spec.compiler.discardvisual = True
    before = spec.compile()
    model = compile_with(spec, parts)
    alone = bits(fit_parts(model, mujoco.MjData(model), before, parts))
    assert bits(changed) == alone != bits(before)
    changed.body_pos[:] += 1.0
    changed.opt.timestep = 0.002
    assert bits(load_model(parts=parts, drawn=False)) == alone


def test_a_file_that_has_changed_is_read_again(tmp_path):
    file = tmp_path / "model.xml"
    text = model_path().read_text(encoding="utf-8")
    for step in (0.001, 0.0005):
        file.write_text(text.replace('timestep="0.001"', f'timestep="{step}"'), encoding="utf-8")
        for parts in (None, Parts(sliding=0.3), Parts(mass=0.03)):
            assert load_model(file, parts).opt.timestep == step


def test_the_fields_in_which_mechanisms_of_one_ball_and_plate_differ_are_known():
    each = [Parts(), *FITTED]
    models = [load_model(parts=parts, drawn=False) for parts in each]
    found = differing(models)
    assert found.keys() == differing(models, fields_of(each)).keys()
    assert found.keys() >= {"opt.gravity", "key_qpos", "pair_solref"}
    mixed = [*each, COMPILED[0]]
    models = [load_model(parts=parts, drawn=False) for parts in mixed]
    assert "body_mass" in differing(models, fields_of(mixed))
