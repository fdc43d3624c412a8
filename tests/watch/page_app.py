"""The page over a fleet that runs five slots whenever it is asked: what NiceGUI's user simulation starts."""

from tsjepa.envs import Radio
from tsjepa.evaluation.rollouts import Loop
from tsjepa.plants import CartPole
from tsjepa.watch.fleet import RunningFleet
from tsjepa.watch.page import serve
from tsjepa.watch.screen import Screen
from tsjepa.watch.setting import Setting

plant = CartPole(process_noise_std=0.008)
setting = Setting(devices=4, snr_db=20.0, loss=0.0, scheduler="round_robin", codec="fp32")
fleet = RunningFleet(Loop(plant, "linear", slots=2**31, radio=Radio(resource_blocks=2), frame_history=2), setting)
pushed = []


def ask(wanted, devices):
    pushed.extend(devices)
    fleet.change(wanted)
    for _ in range(5):
        fleet.slot()
    return fleet.snapshot()


screen = Screen(ask, setting, plant, "linear")
serve(screen, ["fp32", "fp16"], ["round_robin", "none"], 8080)
