"""tsjepa: predictive remote control from pixels over a radio that cannot carry video."""

from tsjepa.gl import choose_backend

choose_backend()
