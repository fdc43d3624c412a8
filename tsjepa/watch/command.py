"""``tsjepa watch``: a fleet that runs in real time, on a web page of this machine."""

from __future__ import annotations

import importlib.util
import socket

from tsjepa.envs import Radio
from tsjepa.evaluation.conditions import warn_of_another_renderer
from tsjepa.evaluation.rollouts import Loop
from tsjepa.evaluation.simulate import load_controller, plant_for
from tsjepa.models import Controller
from tsjepa.plants import Plant
from tsjepa.radio import IidLoss
from tsjepa.radio.schedulers import SCHEDULERS
from tsjepa.support.checks import at_least, within
from tsjepa.watch.process import running
from tsjepa.watch.screen import Screen
from tsjepa.watch.setting import Setting, with_setting

EMBEDDINGS, FRAMES = ("fp32", "fp16", "int8", "int4"), "raw"
SHARED = Radio(resource_blocks=None, bandwidth_mhz=0.1, codec="fp16")


def watch(
    controller: str = "tsjepa-cartpole-d16",
    plant: Plant | None = None,
    num_devices: int = 24,
    scheduler: str = "channel_aware",
    radio: Radio = SHARED,
    frame_history: int = 2,
    seed: int = 0,
    port: int = 8080,
) -> None:
    """Runs a fleet in real time and shows it at http://127.0.0.1:PORT until Ctrl-C; nobody else can reach the page.

    Sliders change the devices, their SNR and the loss; the scheduler and the payload can be chosen, and carts pushed. A
    device that fails starts anew after two seconds. Needs ``pip install 'tsjepa[watch]'``.

    Args:
        controller: a model by name or folder, or one of tsjepa.envs.make.ON_STATE, such as "hold".
        plant: the kind of machine; left out, the one that the model was trained on.
        num_devices: I at the start.
        scheduler: the one at the start, a name in tsjepa.radio.SCHEDULERS or the import path of your own.
        radio: what no slider sets. In the default one the devices share 0.1 MHz: ten resource units a slot.
        frame_history: slots up to a device's step 0, the warm-up at rest; at least those of the model's stack.
        seed: of starts, noise, channels and losses.
        port: of the page.

    Raises:
        ValueError: an argument that cannot be.
        FileNotFoundError: there is no such controller.
        ModuleNotFoundError: NiceGUI is not installed.
        OSError: the port cannot be had.
    """
    at_least(1, num_devices=num_devices)
    within(1, 65535, port=port)
    if importlib.util.find_spec("nicegui") is None:
        raise ModuleNotFoundError("The page needs the package nicegui: pip install 'tsjepa[watch]'.")
    from tsjepa.watch.page import serve

    check_port(port)
    model_or_name = load_controller(controller)
    machine = plant_for(model_or_name, plant)
    loop = Loop(machine, model_or_name, scheduler, num_devices, 2**31, radio, frame_history)
    setting = first_setting(loop)
    with_setting(loop, setting).env(seed).reset()  # says now what does not fit together, also in the first slot
    warn_of_another_renderer(machine.camera(), getattr(model_or_name, "metrics", None))
    with running(loop, controller, setting, seed) as ask:
        print(f"The fleet is at http://127.0.0.1:{port}; Ctrl-C ends it.", flush=True)
        serve(
            Screen(ask, setting, machine, model_or_name),
            codecs_of(loop),
            list(dict.fromkeys([*SCHEDULERS, scheduler])),
            port,
        )


def first_setting(loop: Loop) -> Setting:
    """Where the sliders stand at first: as the radio of ``loop`` says.

    Raises:
        ValueError: a radio that sliders cannot set.
    """
    radio = loop.radio
    if radio.lossless or radio.trace is not None or not isinstance(radio.snr_target_db, float | int):
        raise ValueError(
            "A radio to be watched needs a channel and one snr_target_db: give neither lossless nor trace."
        )
    if not isinstance(radio.loss, IidLoss | None):
        raise ValueError(
            f"The slider sets the probability of an IidLoss, and the radio's loss is a {type(radio.loss).__name__}: "
            "give an IidLoss, or leave loss out."
        )
    loss = 0.0 if radio.loss is None else radio.loss.probability
    return Setting(loop.num_devices, float(radio.snr_target_db), loss, loop.scheduler, radio.codec)


def codecs_of(loop: Loop) -> list[str]:
    """The payloads that the controller of ``loop`` can be sent."""
    model = loop.controller if isinstance(loop.controller, Controller) else None
    lacks_ranges = model is not None and bool(model.code_low.isnan().any())
    fitting = [codec for codec in EMBEDDINGS if not (lacks_ranges and codec.startswith("int"))]
    fitting += [FRAMES] * (model is not None)
    return list(dict.fromkeys([*fitting, loop.radio.codec]))


def check_port(port: int) -> None:
    """Says before anything is started that the port cannot be had.

    Raises:
        OSError: it cannot.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise OSError(
                f"The port {port} cannot be had ({error.strerror}): choose another one with --port."
            ) from error
