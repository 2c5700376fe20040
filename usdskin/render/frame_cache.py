"""What one frame leaves to the next of a job: all that cannot have changed between them.

A part that varies (``usdskin.render.changes``) is not kept, so that a job needs the memory of one
frame. Parts are told apart by identity: what was not read again is the same object.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from usdskin.device import copied
from usdskin.notes import Note
from usdskin.render.changes import EVERYTHING, Changes
from usdskin.render.integrate import FirstFaces
from usdskin.render.light_maps import LightField, stand_domes
from usdskin.render.lights import Lights, only_turned, turn_lights
from usdskin.render.materials import SkinMaterial, SurfaceMaterial
from usdskin.render.meshes import MeshArrays
from usdskin.render.surfaces import Surfaces
from usdskin.warp_kernels import structs

# isort: split
# After ours, which register the schemas.
from pxr import Usd

if TYPE_CHECKING:
    from usdskin.render.light_links import LinkTables
    from usdskin.render.scene import Scene

MOST_FACES = 1 << 25
"""Samples of a picture whose first triangles are kept: 128 MiB."""


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Meshes and what they are made of."""

    meshes: tuple[MeshArrays, ...]
    materials: tuple[SkinMaterial | SurfaceMaterial, ...]
    material_index: dict[str | None, int]
    """Index into ``materials`` by path."""


@dataclass(slots=True, eq=False)
class FrameCache:
    """What is left of the frame before; without one, nothing."""

    changes: Changes = EVERYTHING
    _lights: Lights | None = None
    _shapes: Shapes | None = None
    _materials: tuple[tuple[SkinMaterial | SurfaceMaterial, ...], dict[str | None, int]] | None = (
        None
    )
    _links: LinkTables | None = None
    _geometry: Any = None
    _light: LightField | None = None
    _surfaces: Surfaces | None = None
    _surfaces_for: Any = None
    _of_lights: dict[str, tuple[Lights, Any]] = field(default_factory=dict)
    _first_faces: dict[Hashable, tuple[tuple[object, ...], FirstFaces]] = field(
        default_factory=dict
    )

    # --- Reading ---------------------------------------------------------------------------------

    def lights(self, stage: Usd.Stage, time: Usd.TimeCode, notes: list[Note]) -> Lights | None:
        """Return the lights at a time, None where they have to be read.

        Raises:
            LayerError: A transform cannot be used.
        """
        if self._lights is None or not self.changes.turned:
            return self._lights
        return turn_lights(stage, time, self._lights, self.changes.turned, notes)

    @property
    def shapes(self) -> Shapes | None:
        """The meshes with their materials, None where they have to be read."""
        return self._shapes

    def materials(
        self, paths: list[str]
    ) -> tuple[tuple[SkinMaterial | SurfaceMaterial, ...], dict[str | None, int]] | None:
        """Return the materials of these paths and their index, None where they are to be read."""
        if self._materials is None:
            return None
        return self._materials if [*self._materials[1]] == [*paths, None] else None

    def links(self, lights: Lights, meshes: tuple[MeshArrays, ...]) -> LinkTables | None:
        """Return the links of these lights and meshes, None where they have to be read."""
        if self._shapes is None or self._lights is None or self._links is None:
            return None
        known = meshes is self._shapes.meshes and lights.paths == self._lights.paths
        return self._links if known else None

    # --- The device ------------------------------------------------------------------------------

    def geometry(self, scene: Scene) -> Any:
        """Return what was uploaded of a scene's meshes, None where they are to be uploaded.

        Its first part is a struct of the caller's own, sharing the arrays.
        """
        if self._geometry is None or not self._is_shaped(scene):
            return None
        return copied(self._geometry[0], structs.Geometry), *self._geometry[1:]

    def light(self, scene: Scene, device: str, brute: bool) -> LightField | None:
        """Return the light of a scene, turned as its domes are now, None where it is to be baked.

        Its struct is the caller's own, sharing the arrays.

        Args:
            scene: The scene.
            device: Where the light is.
            brute: Whether each texel is a lamp, which do not turn.
        """
        if self._light is None or self._lights is None or not self._is_made_of(scene):
            return None
        if scene.lights is self._lights:
            mine = copied(self._light.device_lights, structs.Lights)
            return replace(self._light, device_lights=mine)
        if brute or not only_turned(scene.lights, self._lights):
            return None
        return stand_domes(self._light, scene.lights, device)

    def surfaces(self, scene: Scene, light: LightField, *tables: Any) -> Surfaces | None:
        """Return the material tables under a light, None where they have to be built.

        Args:
            scene: The scene.
            light: The light.
            tables: What else they are built for.
        """
        if self._light is None or not self._is_made_of(scene):
            return None
        same = light.basis is self._light.basis and tables == self._surfaces_for
        return self._surfaces if same else None

    def of_lights(
        self,
        name: str,
        scene: Scene,
        make: Callable[[], Any],
        turn: Callable[[Any, Lights], Any] | None = None,
    ) -> Any:
        """Return something made from a scene's lights alone, or from lights and meshes.

        Args:
            name: What it is.
            scene: The scene.
            make: Makes it.
            turn: Adapts it to lights that have been turned; None returned where it cannot. Without
                it, turned lights change nothing.
        """
        known = self._of_lights.get(name)
        found = None
        if known is not None and (not scene.lights.locals or self._is_shaped(scene)):
            lights, value = known
            if scene.lights is lights:
                found = value
            elif only_turned(scene.lights, lights):
                found = value if turn is None else turn(value, scene.lights)
        if found is None:
            found = make()
        if not self.changes.lights:
            self._of_lights[name] = (scene.lights, found)
        return found

    def first_faces(
        self, scene: Scene, picture: Hashable, view: tuple[object, ...], samples: int
    ) -> FirstFaces | None:
        """Return what keeps the first triangles of a picture's samples.

        None where the frame before saw the scene otherwise, and of pictures too large.

        Args:
            scene: The scene.
            picture: Tells the pictures of a frame apart.
            view: All that they depend on but the scene.
            samples: How many there are.
        """
        if not self._is_shaped(scene) or samples > MOST_FACES:
            return None
        known = self._first_faces.get(picture)
        if known is not None and known[0] == view:
            return known[1]
        self._first_faces[picture] = view, FirstFaces()
        return None

    # --- Keeping ---------------------------------------------------------------------------------

    def keep(
        self, scene: Scene, geometry: Any, light: LightField, surfaces: Surfaces, *tables: Any
    ) -> None:
        """Keep of a scene and its uploaded parts what does not vary."""
        changes = self.changes
        shaped = not (changes.shapes or changes.materials)
        lit = not (changes.lights or changes.materials)
        self._lights = None if changes.lights else scene.lights
        self._materials = None if changes.materials else (scene.materials, scene.material_index)
        self._shapes = (
            Shapes(scene.meshes, scene.materials, scene.material_index) if shaped else None
        )
        self._geometry = geometry if shaped else None
        self._links = scene.links if shaped and not changes.lights else None
        self._light = light if lit else None
        self._surfaces, self._surfaces_for = (surfaces, tables) if lit else (None, None)

    def forget(self) -> None:
        """Keep nothing: a frame failed, and its parts may not belong together."""
        self.__init__(self.changes)  # type: ignore[misc]

    def _is_shaped(self, scene: Scene) -> bool:
        return self._shapes is not None and scene.meshes is self._shapes.meshes

    def _is_made_of(self, scene: Scene) -> bool:
        return self._materials is not None and scene.materials is self._materials[0]
