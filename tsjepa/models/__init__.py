"""Plain ``nn.Module`` networks; no training code and no knowledge of the radio or the plant."""

from tsjepa.models.actor import Actor
from tsjepa.models.autoencoder import AutoencoderController, StateEstimator
from tsjepa.models.controller import Controller
from tsjepa.models.decoder import Decoder
from tsjepa.models.difference_encoder import DifferenceEncoder
from tsjepa.models.encoder import Encoder
from tsjepa.models.hierarchy import HierarchicalPredictor
from tsjepa.models.observer import Observer
from tsjepa.models.onnx_encoder import OnnxEncoder
from tsjepa.models.predictor import Predictor, rollout
from tsjepa.models.probe import StateProbe
from tsjepa.models.semantic import SemanticController
from tsjepa.models.timm_encoder import TimmEncoder

__all__ = [
    "Actor",
    "AutoencoderController",
    "Controller",
    "Decoder",
    "DifferenceEncoder",
    "Encoder",
    "HierarchicalPredictor",
    "Observer",
    "OnnxEncoder",
    "Predictor",
    "SemanticController",
    "StateEstimator",
    "StateProbe",
    "TimmEncoder",
    "rollout",
]
