"""One cart-pole with its camera, as a TorchRL environment on top of dm_control."""

from __future__ import annotations

from dm_control.rl.control import Environment
from torchrl.data import Bounded
from torchrl.envs import DMControlWrapper, RenameTransform, TransformedEnv

from tsjepa.envs.camera import HEIGHT, WIDTH
from tsjepa.envs.physics import CartPolePhysics
from tsjepa.envs.starts import StartDistribution
from tsjepa.envs.task import STATE_KEY, Regulation


def make_env(
    sampling_interval: float = 0.02,
    process_noise_std: float | tuple[float, float] = 0.0,
    episode_length: int = 100,
    random_colors: bool = False,
    seed: int | None = None,
    start: StartDistribution | str = "evaluation",
) -> TransformedEnv:
    """Build the single-device plant.

    Keys: `pixels` [64, 128, 3] uint8, `state` [4] float32 (m, rad, m/s, rad/s), `action` [1] in newtons, `reward` [1].
    TorchRL's `set_seed` reseeds it. For more devices, or frames only where they are needed, use `FleetEnv`.

    Args:
        sampling_interval: slot length in seconds; the physics is stepped at 2 ms or less with the force held.
        process_noise_std: noise added to (x_dot, theta_dot) after every slot, standard deviations in m/s and rad/s.
        episode_length: slots until truncation.
        random_colors: draw the colours of cart and pole in every episode.
        seed: seed of starts, colours and noise; None for a fresh one.
        start: a `StartDistribution`, or "evaluation" for its default.

    Raises:
        ValueError: for a bad argument here, or a force that is not in [-20, 20] N in `step`.
        RuntimeError: if no GL backend is installed.
    """
    if episode_length < 1:
        raise ValueError(f"episode_length must be at least 1, got {episode_length}.")
    if start == "evaluation":
        start = StartDistribution()
    if not isinstance(start, StartDistribution):
        raise ValueError(f'start must be a StartDistribution or "evaluation", got {start!r}.')
    environment = Environment(
        CartPolePhysics.for_interval(sampling_interval),
        Regulation(start, process_noise_std, random_colors, seed),
        # Half a slot less, because dm_control counts slots by a division that may round up.
        time_limit=(episode_length - 0.5) * sampling_interval,
        control_timestep=sampling_interval,
    )
    env = DMControlWrapper(
        environment, from_pixels=True, pixels_only=False, render_kwargs={"height": HEIGHT, "width": WIDTH}
    )
    # dm_control declares float64 rewards.
    env.reward_spec = Bounded(0.0, 1.0, (1,))
    return TransformedEnv(env, RenameTransform([STATE_KEY], ["state"]))
