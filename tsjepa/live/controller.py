"""``tsjepa controller``: keeps beliefs about many devices, answers their updates, predicts what does not come."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack

from tsjepa.live.controller_loop import Controller
from tsjepa.live.device import LAST_DEVICE, weather_of
from tsjepa.live.ending import check_report, run_until_stopped, stages_line, write_report
from tsjepa.live.graphs import Graphs
from tsjepa.live.packet import most_commands
from tsjepa.live.port import address_text, dropped_line, parse_address
from tsjepa.live.recorded import recorded
from tsjepa.live.seal import read_key
from tsjepa.support.checks import at_least, within


def controller(
    graphs: str,
    bind: str = "127.0.0.1:5700",
    num_devices: int = 1,
    reference: Sequence[float] = (),
    buffer: int = 1,
    key: str | None = None,
    seconds: float | None = None,
    loss: float = 0.0,
    delay: float = 0.0,
    jitter: float = 0.0,
    seed: int = 0,
    realtime_factor: float = 1.0,
    log: str | None = None,
    report: str | None = None,
    record: str | None = None,
) -> dict:
    """Controls devices in real time until SIGINT or SIGTERM.

    Args:
        graphs: folder that ``tsjepa deploy MODEL FOLDER`` has written, the same as at the devices.
        bind: HOST:PORT to listen at.
        num_devices: devices 0 to this less 1 are known; what others send is dropped.
        reference: set-points, where the model takes some.
        buffer: N, commands in a packet: for its slot and those after it.
        key: file of 64 hexadecimal digits that the devices have too: what was not sealed with it is dropped.
        seconds: until it ends by itself; None for never.
        loss: share of the commands that are lost on purpose.
        delay: milliseconds by which commands are delayed.
        jitter: milliseconds by which they may be delayed further.
        seed: of the losses, as that of ``tsjepa simulate``.
        realtime_factor: how fast time passes, as at the devices.
        log: CSV file that lists every update that was used.
        report: JSON file for what happened.
        record: path of an ``.rrd`` file for the Rerun viewer: the age behind every command. It is opened together with
            that of the devices. Needs ``pip install 'tsjepa[record]'``.

    Raises:
        ValueError: an argument that cannot be.
        FileNotFoundError: there is no such deployment.
        OSError: the address is taken, or the log or the report cannot be written.
    """
    run = Graphs(graphs, ["receive", "predict"], reference)
    within(1, LAST_DEVICE + 1, num_devices=num_devices)
    within(1, most_commands(len(run.low)), buffer=buffer)
    at_least(0, **({} if seconds is None else {"seconds": seconds}))
    if buffer > 1 and not run.has_predictor:
        raise ValueError(f"A buffer of {buffer} commands needs a model that predicts; this one holds its last command.")
    if not realtime_factor > 0:
        raise ValueError(f"realtime_factor {realtime_factor} has to be above 0.")
    weather = weather_of(run.slot, seed, loss=loss, delay=delay, jitter=jitter, downlink=True)
    address, seal = parse_address(bind), read_key(key)
    check_report(report)
    # before a file is begun: whoever starts a second controller on a port keeps the log and the recording of the first
    loop = Controller(run, num_devices, address, seal, weather, buffer, realtime_factor)
    with ExitStack() as opened:
        opened.callback(loop.port.socket.close)
        loop.record = opened.enter_context(recorded(record, run.spec, range(num_devices)))
        if log:
            loop.log = opened.enter_context(open(log, "wb", buffering=0))
            loop.log.write(b"time_s,device,slot\n")
        print(f"Listens at {address_text(loop.port.address)} for devices 0 to {num_devices - 1}.", flush=True)
        run_until_stopped(lambda stop: loop.run(math.inf if seconds is None else seconds, stop))
    result = loop.summary()
    refused = result["counts"]["refused"]
    print(
        f"{result['devices_heard']} devices, {result['counts']['updates']} updates used, "
        f"{result['counts']['commands']} commands sent{f', {refused} refused' if refused else ''}, "
        f"{dropped_line(result['dropped'])}; {stages_line(result['stages'])}"
    )
    write_report(report, result)
    return result
