"""A batch of linear plants that stands in for the cart-poles."""

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
            qpos=Unbounded((*shape, frame_history, 2)),
            colors=Unbounded((*shape, 2, 3)),
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
                "qpos": state.unsqueeze(-2).repeat_interleave(self.frame_history, -2),
                "colors": torch.full((*shape, 2, 3), 0.5),
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
                "qpos": torch.cat((tensordict["qpos"][..., 1:, :], state.unsqueeze(-2)), -2),
                "colors": tensordict["colors"].clone(),
                "slot": slot,
                "reward": -state.square().sum(-1, keepdim=True),
                "done": done,
                "terminated": done.clone(),
            },
            self.batch_size,
        )

    def _set_seed(self, seed):
        pass


def render(qpos, colors):
    """Frames of 4 x 8 whose first pixel tells the position, in hundredths, and whose second the colour."""
    frames = np.zeros((len(qpos), 4, 8, 3), np.uint8)
    frames[:, 0, 0, 0] = np.clip(np.round(100 * qpos[:, 0]), 0, 255)
    frames[:, 0, 1] = np.round(100 * colors[:, 0])
    return frames
