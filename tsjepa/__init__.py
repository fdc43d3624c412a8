"""tsjepa: predictive remote control from pixels over a radio that cannot carry video."""

from tsjepa.support.gl import choose_backend

choose_backend()

__all__ = ["load"]


def __getattr__(name: str):
    # torch is imported only when a model is asked for, so that `tsjepa --help` stays quick
    if name == "load":
        from tsjepa.models.entries import load

        return load
    raise AttributeError(f"module 'tsjepa' has no attribute {name!r}")
