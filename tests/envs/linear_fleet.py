"""A batch of linear plants that stands in for a fleet."""

import numpy as np
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

A = torch.tensor([[1.0, 0.1], [0.0, 1.02]])
B = torch.tensor([[0.0], [0.1]])


class LinearFleet(EnvBase):
    """x' = A x + B u per device; device i's episode ends after ``lengths[i]`` slots, and rows reset on their own."""

    def __init__(self, batch_size=(4,), lengths=None, frame_history=3):
        super().__init__(device="cpu", batch_size=torch.Size(batch_size))
        shape = self.batch_size
        self.lengths = torch.full(shape, 1000) if lengths is None else torch.as_tensor(lengths).expand(shape)
        self.frame_history = frame_history
        self.observation_spec = Composite(
            state=Unbounded((*shape, 2)),
            scene=Unbounded((*shape, frame_history, 3)),
            slot=Unbounded(shape, dtype=torch.int64),
            shape=shape,
        )
        self.state_spec = self.observation_spec.clone()
        self.action_spec = Bounded(-20.0, 20.0, (*shape, 1))
        self.reward_spec = Unbounded((*shape, 1))

    def _reset(self, tensordict=None, **kwargs):
        shape = self.batch_size
        state = torch.arange(1, shape.numel() + 1).float().view(shape).unsqueeze(-1) * torch.tensor([0.1, -0.2])
        return TensorDict(
            {
                "state": state,
                "scene": seen(state).unsqueeze(-2).repeat_interleave(self.frame_history, -2),
                "slot": torch.zeros(shape, dtype=torch.int64),
            },
            shape,
        )

    def _step(self, tensordict):
        state = tensordict["state"] @ A.mT + tensordict["action"] @ B.mT
        slot = tensordict["slot"] + 1
        done = (slot >= self.lengths).unsqueeze(-1)
        return TensorDict(
            {
                "state": state,
                "scene": torch.cat((tensordict["scene"][..., 1:, :], seen(state).unsqueeze(-2)), -2),
                "slot": slot,
                "reward": -state.square().sum(-1, keepdim=True),
                "done": done,
                "terminated": done.clone(),
            },
            self.batch_size,
        )

    def _set_seed(self, seed):
        pass


def seen(state):
    """What a camera sees of states [..., 2]: them and a colour, [..., 3]."""
    return torch.cat((state, torch.full_like(state[..., :1], 0.5)), -1)


def render(scene):
    """Frames of 4 x 8 whose first pixel tells the position, in hundredths, and whose second the colour."""
    frames = np.zeros((len(scene), 4, 8, 3), np.uint8)
    frames[:, 0, 0, 0] = np.clip(np.round(100 * scene[:, 0]), 0, 255)
    frames[:, 0, 1] = np.round(100 * scene[:, 2:])
    return frames
