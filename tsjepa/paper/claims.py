"""The claims of the paper's abstract and evaluation section, each a line of the report's verdict table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

OWN = "expected by us, not printed"  # as the source of a claim
REPRODUCED, PARTLY, NOT, UNMEASURED = "reproduced", "partly", "not", "not measured"


@dataclass(frozen=True)
class Claim:
    """One claim.

    Args:
        figure: module that measures it.
        source: where the paper makes it.
        text: what it says.
    """

    figure: str
    source: str
    text: str


@dataclass(frozen=True)
class Verdict:
    """What the recorded results say about a claim.

    Args:
        verdict: one of the four above.
        ours: our figures.
        reason: what in the figures speaks against it; empty where it holds.
    """

    verdict: str
    ours: str
    reason: str = ""


def judge(holds: bool, ours: str, reason: str = "", partly: bool = False) -> Verdict:
    """Reproduced where it holds; else partly or not, with the reason."""
    if holds:
        return Verdict(REPRODUCED, ours)
    return Verdict(PARTLY if partly else NOT, ours, reason)


def setbacks(values: Mapping[float, float], rising: bool = True) -> str:
    """The steps at which a series by its abscissa does not rise (or fall), in words; empty where there are none."""
    steps = [
        f"{first:g} to {second:g}"
        for (first, before), (second, after) in pairwise(values.items())
        if (after <= before if rising else after >= before)
    ]
    return f"it does not {'rise' if rising else 'fall'} from {', '.join(steps)}" if steps else ""


CLAIMS = {
    "fewer_bits": Claim(
        "bits", "abstract", "Low-dimensional embeddings reduce the communication overhead of high-dimensional frames."
    ),
    "prediction_helps": Claim(
        "one_device",
        "abstract",
        "Future embeddings, predicted from the current one and the commands, feed the actor directly; nothing is "
        "reconstructed.",
    ),
    "scheduler_helps": Claim(
        "schedulers",
        "abstract",
        "Scheduling by channel and age of information makes control more reliable and communication more efficient.",
    ),
    "beats_baselines_bits": Claim(
        "one_device", "abstract", "Significantly better than the control baselines in communication efficiency."
    ),
    "beats_baselines_cost": Claim(
        "one_device", "abstract", "Significantly better than the control baselines in control cost."
    ),
    "beats_baselines_prediction": Claim(
        "one_device", "abstract", "Significantly better than the control baselines in predictive accuracy."
    ),
    "scales": Claim(
        "devices_encoding",
        "abstract",
        "Robust and scalable control under limited capacity compared with traditional scheduling.",
    ),
    "interval_changes_frames": Claim(
        "frame_change",
        "temporal and spatial consistency",
        "Sampling less often makes consecutive frames differ more; sampled too often they are nearly identical.",
    ),
    "augmentation_five_fold": Claim(
        "frame_change",
        "temporal and spatial consistency",
        "Image augmentation raises the range of the MAPE up to five-fold.",
    ),
    "one_millisecond": Claim(
        "frame_change", "simulation set-up", "A sampling interval of 1 ms captures meaningful temporal dynamics."
    ),
    "clusters": Claim(
        "tsne",
        "encoder performance",
        "TS-JEPA's embeddings form distinct clusters of device states; the autoencoder's overlap more.",
    ),
    "colour": Claim(
        "tsne",
        "encoder performance",
        "Two frames of one state in different colours lie close together for TS-JEPA, far apart for the autoencoder.",
    ),
    "lowest_nmae": Claim(
        "one_device",
        "encoding and prediction",
        "With an update in every slot TS-JEPA has the lowest command error of the learned controllers.",
    ),
    "near_optimal": Claim(
        "one_device",
        "encoding and prediction",
        "With an update in every slot TS-JEPA's normalised score is nearly optimal.",
    ),
    "far_fewer_bits": Claim(
        "one_device", "encoding and prediction", "It needs significantly fewer bits than sending the frames."
    ),
    "autoencoder_order": Claim(
        "one_device",
        "encoding and prediction",
        "The autoencoder has a higher command error than TS-JEPA, yet scores above the supervised baseline.",
    ),
    "more_frames": Claim(
        "one_device",
        "encoding and prediction",
        "Going from 2 to 4 frames improves the supervised controller and costs more bits.",
    ),
    "supervised_generalises": Claim(
        "one_device",
        "encoding and prediction",
        "The supervised controller generalises poorly from so few trajectories.",
    ),
    "once_nmae": Claim(
        "one_device",
        "encoding and prediction",
        "Sent once, TS-JEPA keeps the lowest command error over the horizon; repeated and zero actions get worse.",
    ),
    "once_growth": Claim(
        "one_device",
        "encoding and prediction",
        "Sent once, TS-JEPA's command error increases only slightly over the horizon.",
    ),
    "once_score": Claim(
        "one_device",
        "encoding and prediction",
        "Sent once, TS-JEPA scores better than every baseline, the optimal policy included.",
    ),
    "dimension_nmae": Claim("dimension", "embedding dimension", "A larger embedding lowers the command error."),
    "dimension_bits": Claim("dimension", "embedding dimension", "A larger embedding costs more bits."),
    "dimension_score": Claim("dimension", "embedding dimension", "A larger embedding keeps the score up for longer."),
    "data_nmae": Claim("dataset_size", "training data-set size", "More training data lower the command error."),
    "data_bits": Claim("dataset_size", "training data-set size", "More training data cost more bits."),
    "data_score": Claim(
        "dataset_size",
        "training data-set size",
        "More training data keep the score up over longer horizons; with few it declines rapidly.",
    ),
    "data_collapse": Claim(
        "dataset_size", "training data-set size", "Limited training data can make the representation collapse."
    ),
    "snr_nmae": Claim(
        "target_snr",
        "target SNR",
        "Lowering the target SNR from 20 to 5 dB significantly degrades the command error, by the samples lost in "
        "training.",
    ),
    "snr_score": Claim("target_snr", "target SNR", "It lowers the normalised score likewise."),
    "snr_resources": Claim("devices_encoding", "target SNR", "A high target SNR consumes more wireless resources."),
    "devices_schedulers": Claim(
        "devices_encoding",
        "scalability, encoding",
        "With TS-JEPA, channel-aware scheduling serves significantly more devices than round-robin and opportunistic "
        "at every SNR.",
    ),
    "opportunistic_last": Claim(
        "devices_encoding", "scalability, encoding", "Opportunistic scheduling serves the fewest devices."
    ),
    "devices_controllers": Claim(
        "devices_encoding",
        "scalability, encoding",
        "TS-JEPA serves more devices than the supervised controller, also at low SNR.",
    ),
    "devices_loss": Claim(
        "devices_prediction",
        "scalability, prediction",
        "Under packet loss TS-JEPA with channel-aware scheduling serves substantially more devices than the supervised "
        "controller with round-robin and opportunistic scheduling.",
    ),
    "supervised_loss": Claim(
        "devices_prediction",
        "scalability, prediction",
        "TS-JEPA keeps its devices when packets are lost; the supervised controller, without prediction, does not.",
    ),
    "goal_devices": Claim(
        "devices_encoding",
        OWN,
        "TS-JEPA with channel-aware scheduling serves at least 5 times the devices of the supervised controller with "
        "round-robin, and more than with round-robin or opportunistic scheduling itself, at every SNR.",
    ),
    "goal_bits": Claim(
        "bits",
        OWN,
        "At a normalised score of 0.9 an embedding needs at most 1/5 of the bits of the best setting for still "
        "pictures and 1/500 of those of raw frames.",
    ),
}
