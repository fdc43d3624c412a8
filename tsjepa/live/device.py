"""``tsjepa device``: watches a machine, sends embeddings by UDP, applies the commands that come back."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np

from tsjepa.live.camera import Camera, find_actuator
from tsjepa.live.device_loop import Device
from tsjepa.live.ending import check_report, run_until_stopped, stages_line, write_report
from tsjepa.live.graphs import Graphs
from tsjepa.live.notices import tell
from tsjepa.live.port import dropped_line, parse_address
from tsjepa.live.recorded import recorded
from tsjepa.live.seal import read_key
from tsjepa.support.checks import at_least, within

LAST_DEVICE = 65535


def device(
    graphs: str,
    controller: str = "127.0.0.1:5700",
    number: int = 0,
    num_devices: int = 1,
    camera: str | None = None,
    actuator: str | None = None,
    plant: dict | None = None,
    period: int = 1,
    slots: int | None = None,
    episode_slots: int | None = None,
    frame_history: int = 1,
    watchdog_ms: float = 200.0,
    safe: Sequence[float] | None = None,
    key: str | None = None,
    loss: float = 0.0,
    delay: float = 0.0,
    jitter: float = 0.0,
    trace: str | None = None,
    seed: int = 0,
    realtime_factor: float = 1.0,
    report: str | None = None,
    record: str | None = None,
) -> dict:
    """Runs a device, or several, in real time until SIGINT or SIGTERM. The controller may be anywhere, and may restart.

    Args:
        graphs: folder that ``tsjepa deploy MODEL FOLDER`` has written.
        controller: its HOST:PORT.
        number: of the (first) device, 0 to 65535; one that the controller knows.
        num_devices: simulated plants of this process.
        camera: number of a camera or a file, for OpenCV; without one a plant is simulated.
        actuator: package.module.function that is called with each command of a device with a camera.
        plant: class_path and init_args of the simulated plant; the model's own if left out.
        period: slots between updates.
        slots: until it ends by itself; None for never.
        episode_slots: slots after which a simulated plant begins anew, None for never.
        frame_history: slots at rest up to slot 0 of a simulated plant, as of ``tsjepa evaluate``.
        watchdog_ms: milliseconds without a command after which the safe command is applied.
        safe: the safe command; the one nearest to zero if left out.
        key: file of 64 hexadecimal digits that the controller has too: updates and commands are sealed.
        loss: share of the updates that are lost on purpose.
        delay: milliseconds by which updates are delayed.
        jitter: milliseconds by which they may be delayed further.
        trace: file of measured links, whose losses and delays are played.
        seed: of the simulated plant and of all losses, as that of ``tsjepa simulate``.
        realtime_factor: how fast time passes; 0.5 on a machine that is half as fast as it had to be.
        report: JSON file for what happened.
        record: path of an ``.rrd`` file for the Rerun viewer: pictures, states, commands and what was sent. Needs
            ``pip install 'tsjepa[record]'``.

    Raises:
        ValueError: an argument that cannot be.
        FileNotFoundError: there is no such deployment or camera, or the camera gives no picture.
        OSError: the report cannot be written, or there is no way to the controller.
        ModuleNotFoundError: simulated plants and weather need torch.
    """
    at_least(1, num_devices=num_devices, period=period, **({} if slots is None else {"slots": slots}))
    within(0, LAST_DEVICE + 1 - num_devices, number=number)
    if not realtime_factor > 0 or not watchdog_ms > 0:
        raise ValueError(f"realtime_factor {realtime_factor} and watchdog_ms {watchdog_ms} have to be above 0.")
    if actuator is not None and camera is None:
        raise ValueError(
            f"The actuator {actuator} needs a camera; without one a plant is simulated, which has its own."
        )
    run = Graphs(graphs, ["device"], reference=None)
    numbers = list(range(number, number + num_devices))
    # what is wrong is told before a camera is opened and a file begun
    address, seal = parse_address(controller), read_key(key)
    safe_command = None if safe is None else checked_safe(safe, run)
    weather = weather_of(run.slot, seed, loss=loss, delay=delay, jitter=jitter, trace=trace)
    check_report(report)
    with ExitStack() as opened:
        if camera is None:
            machine = _simulated(run, plant, numbers, seed, episode_slots, frame_history)
        else:
            if num_devices > 1:
                raise ValueError(f"num_devices is {num_devices}; a process with a camera is one device.")
            machine = Camera(camera, find_actuator(actuator), run.frame, run.frame_stack, run.frame_spacing)
            opened.callback(machine.close)
        write = opened.enter_context(recorded(record, run.spec if camera else machine.plant.spec, numbers))
        loop = Device(
            run,
            machine,
            numbers,
            address,
            seal,
            weather,
            period,
            1e-3 * watchdog_ms,
            safe_command,
            realtime_factor,
            write,
        )
        run_until_stopped(lambda stop: loop.run(slots, stop))
    result = loop.summary()
    failures = [
        f", {count} {name.replace('_', ' ')}"
        for name, count in result["machine"].items()
        if name.endswith("_failures") and count
    ]
    print(
        f"{result['slots']} slots, {result['missed_deadlines']} deadlines missed, {result['updates']['sent']} updates "
        f"sent, {result['commands']['received']} commands received, {dropped_line(result['dropped'])}"
        f"{''.join(failures)}; {stages_line(result['stages'])}"
    )
    if unheard := result["devices_without_a_command"]:
        tell("device", loop.silence.sentence(unheard, "in the whole run"))
    write_report(report, result)
    return result


def checked_safe(safe: Sequence[float], graphs: Graphs) -> np.ndarray:
    """The safe command [m].

    Raises:
        ValueError: not of the actuator's range or size.
    """
    command = np.asarray(safe, np.float32)
    if command.shape != graphs.low.shape or not ((command >= graphs.low) & (command <= graphs.high)).all():
        raise ValueError(f"The safe command {list(safe)} is not between {graphs.low} and {graphs.high}.")
    return command


def weather_of(slot_s: float, seed: int, downlink: bool = False, **options: Any) -> Any:
    """Losses and delays on purpose, or None.

    Raises:
        ModuleNotFoundError: the radio's models compute with torch, which a device may lack.
    """
    if not any(options.values()):
        return None
    try:
        from tsjepa.live.weather import Weather
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"Losses on purpose need {error.name}, which is not installed here: shape the network with `tc netem`."
        ) from error
    return Weather(seed=seed, slot_s=slot_s, downlink=downlink, **options)


def _simulated(
    graphs: Graphs, plant: dict | None, numbers: list[int], seed: int, episode_slots: int | None, frame_history: int
) -> Any:
    described = plant or graphs.description["plant"]
    if described is None:
        raise ValueError("The model was trained on a recording and names no plant: give a camera, or a plant.")
    try:
        from tsjepa.live.simulated import SimulatedPlants
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"Simulated plants need {error.name}, which is not installed here: give a camera, or install all of tsjepa."
        ) from error
    return SimulatedPlants(
        described, np.array(numbers), seed, episode_slots, frame_history, graphs.frame_stack, graphs.frame_spacing
    )
