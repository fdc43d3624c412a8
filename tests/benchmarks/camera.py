"""Frames per second of the camera inside the fleet, beside the stock way and beside nothing but the rendering.

    python tests/benchmarks/camera.py            # about two minutes on an idle machine

Three contenders, each in a process of its own because their GL contexts get in each other's way, take turns:

- fleet: ``FleetEnv`` of 64 devices with the network's ``Camera`` behind it, every row rendered in every slot, physics
  and TorchRL included; one new frame a device and slot;
- stock: dm_control's cart-pole in TorchRL's ``DMControlWrapper`` at 64 x 128, stepped with random commands;
- bare: ``mjr_render`` and ``mjr_readPixels`` of one whole still picture with the fleet's camera, flags and samples, in
  a loop. The fleet can beat it, since it renders only the rectangle in which something moves.
"""

import argparse
import multiprocessing
import time
from collections.abc import Callable

import tsjepa  # noqa: F401  (chooses the GL backend before mujoco is imported)


def fleet(devices: int, frame_stack: int) -> tuple[Callable[[int], int], dict]:
    import torch
    from torchrl.envs import TransformedEnv

    from tsjepa.envs import FleetEnv
    from tsjepa.envs.transforms import Camera
    from tsjepa.plants import CartPole

    torch.set_num_threads(1)
    plant = CartPole()
    limit = plant.spec.action_high[0] / 10
    plants = FleetEnv(plant, devices, 10**9, frame_history=frame_stack, terminate_on_failure=False)
    env = TransformedEnv(plants, Camera(plant.render, plant.spec.frame, frame_stack))
    state = {"now": env.reset()}
    generator = torch.Generator().manual_seed(0)

    def make(frames: int) -> int:
        slots = -(-frames // (devices * frame_stack))
        state["now"] = env.reset()
        for _ in range(slots):
            force = limit * (2 * torch.rand(devices, 1, generator=generator) - 1)
            state["now"] = env.step(state["now"].set("action", force))["next"]
        return slots * devices * frame_stack

    return make, plant.camera()


def stock() -> tuple[Callable[[int], int], dict]:
    import torchrl  # noqa: F401  (before dm_control)
    from dm_control import suite
    from torchrl.envs import DMControlWrapper

    env = DMControlWrapper(
        suite.load("cartpole", "balance", task_kwargs={"random": 0}),
        from_pixels=True,
        pixels_only=False,
        render_kwargs={"height": 64, "width": 128, "camera_id": 0},
    )
    state = {"now": env.reset()}

    def make(frames: int) -> int:
        for _ in range(frames):
            following = env.rand_step(state["now"])["next"]
            state["now"] = env.reset() if bool(following["done"]) else following
        return frames

    return make, {}


def bare() -> tuple[Callable[[int], int], dict]:
    import mujoco
    import numpy as np

    from tsjepa.plants import CartPole

    renderer = CartPole().renderer
    renderer.render(np.array([[0.1, 0.1]]))
    scale = renderer.view.supersampling
    viewport = mujoco.MjrRect(0, 0, scale * renderer.width, scale * renderer.height)
    buffer = np.empty((viewport.height, viewport.width, 3), np.uint8)
    for camera in renderer._scene.camera:  # back from the last frame's part to the whole picture
        renderer._lens.aim(camera, np.array((0, 0, renderer.width, renderer.height)))

    def make(frames: int) -> int:
        renderer._gl.make_current()  # and it keeps the renderer alive, with which its context would be freed
        for _ in range(frames):
            mujoco.mjr_render(viewport, renderer._scene, renderer._context)
            mujoco.mjr_readPixels(buffer, None, viewport, renderer._context)
        return frames

    return make, {}


def serve(connection, name: str, arguments: tuple) -> None:
    """Makes as many frames as it is told to, and answers with frames per second."""
    make, metadata = globals()[name](*arguments)
    make(1)
    connection.send(metadata)
    while frames := connection.recv():
        start = time.perf_counter()
        made = make(frames)
        connection.send(made / (time.perf_counter() - start))


def measure(devices: int, frame_stack: int, rounds: int, frames: int) -> dict:
    """Frames per second and their ratios within each round; stock makes a tenth of the frames of the others."""
    from report import spread

    context = multiprocessing.get_context("spawn")
    contenders, metadata = {}, {}
    for name, arguments in (("fleet", (devices, frame_stack)), ("stock", ()), ("bare", ())):
        connection, other = context.Pipe()
        process = context.Process(target=serve, args=(other, name, arguments), daemon=True)
        process.start()
        other.close()
        metadata |= connection.recv()
        contenders[name] = (process, connection)
    speeds = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, (_, connection) in contenders.items():
            connection.send(frames // 10 if name == "stock" else frames)
            speeds[name].append(connection.recv())
    for process, connection in contenders.values():
        connection.send(0)
        process.join()
    ratio = {
        name: spread([ours / theirs for ours, theirs in zip(speeds["fleet"], speeds[name], strict=True)])
        for name in ("stock", "bare")
    }
    return {
        "devices": devices,
        "frame_stack": frame_stack,
        "camera": metadata,
        "frames_per_second": {name: spread(values) for name, values in speeds.items()},
        "fleet_over_stock": {**ratio["stock"], "target": 20},
        "fleet_over_bare": {**ratio["bare"], "target": 0.9},
    }


def main() -> None:
    from report import publish

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", type=int, default=64, help="I")
    parser.add_argument("--frame-stack", type=int, default=1, help="frames a device and slot")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--frames", type=int, default=1280, help="frames a round and contender; a tenth for stock")
    parser.add_argument("--output", default="docs/results/camera.json")
    options = parser.parse_args()
    publish(options.output, measure(options.devices, options.frame_stack, options.rounds, options.frames))


if __name__ == "__main__":
    main()
