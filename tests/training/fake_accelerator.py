"""An accelerator that computes nothing: torch's meta device, with what would be wrong on a GPU found out.

Whoever reads a number from it waits for it on a GPU and gets a one here; whoever mixes its tensors with the CPU's is
refused as on a GPU; and products and convolutions are counted by the device that they run on.
"""

from collections import Counter

import torch
from lightning.pytorch.accelerators import CPUAccelerator
from lightning.pytorch.strategies import SingleDeviceStrategy
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

META = torch.device("meta")
PRODUCTS = ("convolution", "convolution_backward", "addmm", "mm", "bmm", "baddbmm", "_linalg_svd", "_linalg_solve_ex")
SMALL = 100  # numbers; the gains of an expert are solved for on the CPU, and nothing is lost


class FakeAccelerator(TorchDispatchMode):
    """While it is entered, ``products`` counts the products and convolutions on each kind of device."""

    def __init__(self) -> None:
        super().__init__()
        self.products = Counter()

    def __torch_dispatch__(self, function, types, arguments=(), options=None):
        options = options or {}
        tensors = [leaf for leaf in tree_leaves((arguments, options)) if isinstance(leaf, torch.Tensor)]
        kinds = {tensor.device.type for tensor in tensors if tensor.ndim}
        name = function.overloadpacket.__name__
        if name in PRODUCTS:
            self.products.update({tensor.device.type for tensor in tensors if tensor.numel() > SMALL})
        if "meta" not in {tensor.device.type for tensor in tensors}:
            return function(*arguments, **options)
        if name == "_local_scalar_dense":
            return True if arguments[0].dtype == torch.bool else 1
        if name == "_to_copy" and torch.device(options.get("device") or META).type == "cpu":
            return torch.zeros(arguments[0].shape, dtype=options.get("dtype") or arguments[0].dtype)
        if name == "copy_":
            return arguments[0]
        if name in ("index", "index_put_"):  # a GPU takes an index from the CPU
            arguments = tree_map(lambda leaf: leaf.to(META) if isinstance(leaf, torch.Tensor) else leaf, arguments)
        elif "cpu" in kinds:
            raise AssertionError(f"{name} mixes tensors of the accelerator with the CPU's")
        return function(*arguments, **options)


class MetaAccelerator(CPUAccelerator):
    """Lets Lightning train on the meta device."""

    def setup_device(self, device: torch.device) -> None:
        pass


def strategy() -> SingleDeviceStrategy:
    """Of a ``lightning.Trainer`` on the accelerator."""
    return SingleDeviceStrategy(device=META, accelerator=MetaAccelerator())
