"""dm_control's own models, changed at run time to what a plant needs: newtons, a camera, nothing that only costs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import mujoco


def load_suite_model(domain: str, edit: Callable[[mujoco.MjSpec], None], **arguments) -> mujoco.MjModel:
    """Compiles a model of the installed dm_control suite after ``edit`` has changed it.

    Args:
        domain: module of ``dm_control.suite``, such as "cartpole".
        edit: changes the MjSpec in place.
        arguments: of the module's ``get_model_and_assets``.

    Raises:
        ModuleNotFoundError: dm_control is not installed.
    """
    import importlib

    import mujoco

    module = importlib.import_module(f"dm_control.suite.{domain}")
    xml, files = module.get_model_and_assets(**arguments)
    spec = mujoco.MjSpec.from_string(xml if isinstance(xml, str) else xml.decode(), include=dict(files))
    edit(spec)
    return spec.compile()


def simplify(spec: mujoco.MjSpec, hide: Sequence[str], colors: dict[str, Sequence[float]]) -> None:
    """Takes out what costs time in every picture and shows nothing: textures, sky, the geoms in ``hide``.

    Curved shapes become coarse, cameras go (one called "view" comes), energy is not computed.

    Args:
        spec: changed in place.
        hide: names of geoms.
        colors: RGB in [0, 1] of materials by name; the others keep theirs.
    """
    for name in hide:
        spec.delete(spec.geom(name))
    for camera in list(spec.cameras):
        spec.delete(camera)
    for material in list(spec.materials):
        for layer in range(len(material.textures)):
            material.textures[layer] = ""
        if material.name in colors:
            material.rgba = [*colors[material.name], 1.0]
    for texture in list(spec.textures):
        spec.delete(texture)
    spec.option.enableflags = 0
    quality = spec.visual.quality
    quality.numslices, quality.numstacks, quality.numquads = 12, 4, 1
    spec.visual.map.znear = 0.01
    light = spec.visual.headlight
    light.ambient, light.diffuse, light.specular = [0.4] * 3, [0.8] * 3, [0.1] * 3
    spec.worldbody.add_camera(name="view")
