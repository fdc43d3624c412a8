"""A stranger's MuJoCo model: read with what a recipe changes, brought to rest, and measured from there."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from tsjepa.plants.joints import DISPLACEMENTS, RATES, actuator_names, joint_names, names_of
from tsjepa.plants.stepping import MAX_TIMESTEP
from tsjepa.support.recipes import find_recipe

INTEGRATORS = {"Euler": "EULER", "RK4": "RK4", "implicit": "IMPLICIT", "implicitfast": "IMPLICITFAST"}
NUDGE = 1e-6  # m, rad or per second


def load_model(
    xml: str | os.PathLike, action: Mapping[str, Sequence[float]], integrator: str | None = None
) -> mujoco.MjModel:
    """Compiles a file with the commands' ranges, the integrator, and a camera called "view" beside its own.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: MuJoCo cannot read it, or a name is not in it.
    """
    found = find_recipe(str(xml))
    if not Path(found).is_file():
        raise FileNotFoundError(f"There is no model {xml}.")
    try:
        spec = mujoco.MjSpec.from_file(found)
        spec.worldbody.add_camera(name="view")
        model = spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split()).removeprefix("Error: ")
        raise ValueError(
            f"MuJoCo cannot read {xml}: {reason}. If another file includes this one, give that file."
        ) from error
    names = actuator_names(model)
    if not action or set(action) - set(names):
        raise ValueError(
            f"action names {', '.join(action) or 'no actuator'}; the model has {', '.join(names) or 'none'}."
        )
    for name, bounds in action.items():
        if len(bounds) != 2:
            raise ValueError(f"action gives {list(bounds)} for {name}; give its lowest and its highest command.")
        model.actuator_ctrllimited[names.index(name)], model.actuator_ctrlrange[names.index(name)] = 1, bounds
    if integrator is not None:
        if integrator not in INTEGRATORS:
            raise ValueError(f"There is no integrator {integrator!r}; choose {', '.join(INTEGRATORS)}.")
        model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{INTEGRATORS[integrator]}")
        model.opt.timestep = MAX_TIMESTEP
    return model


def settled(model: mujoco.MjModel, pose: str | Mapping[str, float] | None, seconds: float) -> tuple[np.ndarray, bool]:
    """Joint positions [nq] after ``seconds`` from a pose with all commands at 0, and whether anything touches then.

    Raises:
        ValueError: the pose names what is not in the model, or does not stay finite.
    """
    data = mujoco.MjData(model)
    if isinstance(pose, str):
        keys = [model.key(index).name for index in range(model.nkey)]
        if pose not in keys:
            raise ValueError(f"There is no keyframe {pose!r}; the model has {', '.join(keys) or 'none'}.")
        data.qpos[:] = model.key_qpos[keys.index(pose)]
    elif pose:
        names = names_of(model, DISPLACEMENTS)[0]
        if unknown := set(pose) - set(names):
            raise ValueError(f"pose names {', '.join(sorted(unknown))}; the model has {', '.join(names)}.")
        change = np.array([pose.get(name, 0.0) for name in names])
        mujoco.mj_integratePos(model, data.qpos, change, 1.0)
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    if not np.isfinite(data.qpos).all() or any(warning.number for warning in data.warning[5:]):
        raise ValueError(
            f"The machine does not come to rest in {seconds:g} s: its simulation diverges; choose another integrator."
        )
    data.qvel[:], data.act[:] = 0.0, 0.0
    mujoco.mj_forward(model, data)
    return data.qpos.copy(), data.ncon > 0 or not falls(model, data)


def falls(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Whether a body that hangs on nothing accelerates downwards by half of gravity or more."""
    free = model.jnt_dofadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    return bool((data.qacc[free + 2] < 0.5 * min(model.opt.gravity[2], -1e-9)).any())


class Coordinates:
    """The numbers of a state: some of the displacements from a pose, then rates, then sensors.

    Args:
        model: compiled.
        pose: joint positions [nq] that count as zero.
        state: joints, single displacements or rates, and sensors; None for all joints.

    Raises:
        ValueError: a name that is none of these.
    """

    def __init__(self, model: mujoco.MjModel, pose: np.ndarray, state: Sequence[str] | None) -> None:
        self.model, self.pose = model, pose
        self.all_names, units, owners = names_of(model, DISPLACEMENTS, RATES)
        sensors = {model.sensor(index).name: index for index in range(model.nsensor)}
        wanted = joint_names(model) if state is None else list(state)
        if unknown := [name for name in wanted if name not in {*owners, *self.all_names, *sensors}]:
            raise ValueError(
                f"state names {', '.join(unknown)}; the model has the joints {', '.join(joint_names(model))}"
                f"{' and the sensors ' + ', '.join(sensors) if sensors else ' and no sensors'}."
            )
        self.chosen = [
            index
            for half in (range(model.nv), range(model.nv, 2 * model.nv))
            for name in wanted
            for index in half
            if name in (owners[index], self.all_names[index])
        ]
        self.readings = [
            model.sensor_adr[sensors[name]] + part
            for name in wanted
            if name in sensors
            for part in range(model.sensor_dim[sensors[name]])
        ]
        self.names = [self.all_names[index] for index in self.chosen]
        self.units = [units[index] for index in self.chosen] + ["unknown"] * len(self.readings)
        for name in wanted:
            if name in sensors:
                size = model.sensor_dim[sensors[name]]
                self.names += [name] if size == 1 else [f"{name}_{part}" for part in range(size)]
        self.joints = sorted({index % model.nv for index in self.chosen}) or list(range(model.nv))

    def check(self, part: str, limits: Mapping[str, float], known: Sequence[str]) -> None:
        """Refuses limits of coordinates that there are not, and limits that are not positive.

        Raises:
            ValueError: naming them.
        """
        if unknown := set(limits) - set(known):
            raise ValueError(f"{part} names {', '.join(sorted(unknown))}; there are {', '.join(known)}.")
        if bad := {name: limit for name, limit in limits.items() if not limit > 0}:
            raise ValueError(f"{part} has the limits {bad}; they have to be positive.")

    def physics(self, displacement: np.ndarray) -> np.ndarray:
        """Physics [N, nq + nv + na] of displacements and rates [N, 2 nv]."""
        nv, na = self.model.nv, self.model.na
        positions = np.tile(self.pose, (len(displacement), 1))
        for row, change in zip(positions, displacement[:, :nv], strict=True):
            mujoco.mj_integratePos(self.model, row, np.ascontiguousarray(change), 1.0)
        return np.concatenate([positions, displacement[:, nv:], np.zeros((len(displacement), na))], axis=1)

    def displacement(self, physics: np.ndarray) -> np.ndarray:
        """Displacements and rates [N, 2 nv] of physics."""
        nq, nv = self.model.nq, self.model.nv
        changes = np.empty((len(physics), nv))
        for change, row in zip(changes, physics, strict=True):
            mujoco.mj_differentiatePos(self.model, change, 1.0, self.pose, np.ascontiguousarray(row[:nq]))
        return np.concatenate([changes, physics[:, nq : nq + nv]], axis=1)

    def state(self, physics: np.ndarray) -> np.ndarray:
        """States [N, n]."""
        chosen = self.displacement(physics)[:, self.chosen]
        if not self.readings:
            return chosen
        at_rest = self._sensors(self.physics(np.zeros((1, 2 * self.model.nv))))
        return np.concatenate([chosen, self._sensors(physics) - at_rest], axis=1)

    def _sensors(self, physics: np.ndarray) -> np.ndarray:
        data, nq, nv = mujoco.MjData(self.model), self.model.nq, self.model.nv
        values = np.empty((len(physics), len(self.readings)))
        for value, row in zip(values, physics, strict=True):
            data.qpos[:], data.qvel[:], data.act[:] = row[:nq], row[nq : nq + nv], row[nq + nv :]
            mujoco.mj_forward(self.model, data)
            value[:] = data.sensordata[self.readings]
        return values

    def jacobian(self) -> np.ndarray:
        """How states follow from displacements, at the pose: [n, 2 nv]."""
        steps = NUDGE * np.eye(2 * self.model.nv)
        after = self.state(self.physics(np.concatenate([steps, -steps])))
        return (after[: len(steps)] - after[len(steps) :]).T / (2 * NUDGE)
