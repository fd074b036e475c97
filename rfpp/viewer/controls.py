"""The viewer's controls: layer, objects, lights, reference and export."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from pathlib import Path

import viser
from PIL import Image

from rfpp.errors import UserError
from rfpp.files import as_file_name
from rfpp.imaging.tone_maps import ToneMap
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.io.saving import fits_json, save_scene
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Camera, Scene, SceneObject
from rfpp.viewer import edits
from rfpp.viewer.layers import Layer
from rfpp.viewer.session import Drawn, Reference, Session, path_trace
from rfpp.viewer.viser_cameras import camera_of, move_to

#: Name → factory with an argument `stops`.
ToneMaps = Mapping[str, Callable[..., ToneMap]]
Report = Callable[[str], None]

#: Largest power of a light, relative to the strongest of the loaded scene.
_STRONGEST_LIGHT = 2.0


def add_view(
    client: viser.ClientHandle,
    session: Session,
    layers: Mapping[str, Layer],
    tone_maps: ToneMaps,
    cameras: tuple[Camera, ...],
) -> None:
    """Add layer, tone map, exposure, resolution and the scene's cameras."""
    gui, patch, longer_side = client.gui, session.pacing.patch, session.view.longer_side
    largest, names = max(512, longer_side), tuple(f"camera {number}" for number in range(len(cameras)))
    with gui.add_folder("View"):
        layer = gui.add_dropdown("Show", tuple(layers))
        tone_map = gui.add_dropdown("Tone map", tuple(tone_maps))
        stops = gui.add_slider("Exposure (stops)", min=-6.0, max=6.0, step=0.1, initial_value=0.0)
        side = gui.add_slider("Longer side (pixels)", 8 * patch, largest, step=patch, initial_value=longer_side)
        camera = gui.add_button_group("Go to", names)

    layer.on_update(lambda _: session.change(layer=layers[layer.value]))
    side.on_update(lambda _: session.change(longer_side=max(patch, min(side.value, largest))))
    for handle in (tone_map, stops):
        handle.on_update(lambda _: session.change(tone_map=tone_maps[tone_map.value](stops=stops.value)))
    camera.on_click(lambda _: move_to(client, cameras[names.index(camera.value)]))


class ObjectControls:
    """Transform, material and emission of one object at a time."""

    def __init__(self, client: viser.ClientHandle, session: Session, scene: Scene, report: Report):
        gui = client.gui
        self._session, self._report, self._is_filling = session, report, False
        lights = sorted((item for item in scene.objects if item.material.is_emissive), key=edits.power, reverse=True)
        others = [item for item in scene.objects if not item.material.is_emissive]
        brightest = _STRONGEST_LIGHT * (edits.power(lights[0]) if lights else 1.0)
        with gui.add_folder("Objects and lights"):
            self._name = gui.add_dropdown("Object", tuple(item.name for item in (*lights, *others)))
            drag = gui.add_checkbox("Drag in the picture", initial_value=False)
            self._translation = gui.add_vector3("Position", (0.0, 0.0, 0.0), step=0.01)
            self._rotation = gui.add_vector3("Rotation (degrees)", (0.0, 0.0, 0.0), step=1.0)
            self._scale = gui.add_vector3("Scale", (1.0, 1.0, 1.0), step=0.01)
            self._diffuse = gui.add_rgb("Diffuse", (0, 0, 0))
            self._specular = gui.add_rgb("Specular", (0, 0, 0))
            self._roughness = gui.add_slider("Roughness", min=0.0, max=1.0, step=0.01, initial_value=0.5)
            self._power = gui.add_slider("Light power", 0.0, brightest, step=brightest / 400, initial_value=0.0)
            self._tint = gui.add_rgb("Light color", (255, 255, 255))
            undo = gui.add_button("Undo all edits")
        self._gizmo = client.scene.add_transform_controls("/object", scale=0.2, depth_test=False, visible=False)
        self._name.on_update(lambda _: self._fill())
        for handle in (self._translation, self._rotation, self._scale):
            handle.on_update(lambda _: self._edit(self._moved))
        for handle in (self._diffuse, self._specular, self._roughness):
            handle.on_update(lambda _: self._edit(self._with_material))
        for handle in (self._power, self._tint):
            handle.on_update(lambda _: self._edit(self._with_light))
        undo.on_click(lambda _: (session.change(scene=scene), self._fill()))
        drag.on_update(lambda _: setattr(self._gizmo, "visible", drag.value))
        self._gizmo.on_update(lambda _: self._dragged())
        self._fill()

    def _item(self) -> SceneObject:
        return next(item for item in self._session.view.scene.objects if item.name == self._name.value)

    @contextmanager
    def _filling(self):
        """Set values without editing: viser calls back for them, too."""
        self._is_filling = True
        try:
            yield
        finally:
            self._is_filling = False

    def _fill(self) -> None:
        item = self._item()
        material, transform = item.material, item.transform
        self._place_gizmo(item)
        with self._filling():
            self._translation.value, self._rotation.value = transform.translation, transform.rotation
            self._scale.value, self._roughness.value = transform.scale, material.roughness
            self._diffuse.value, self._specular.value = map(edits.to_picker, (material.diffuse, material.specular))
            self._power.value = min(edits.power(item), self._power.max)
            self._tint.value = edits.to_picker(edits.tint(item))

    def _edit(self, edit: Callable[[SceneObject], SceneObject]) -> None:
        if self._is_filling:
            return
        try:
            item = edit(self._item())
            self._session.change(scene=edits.with_object(self._session.view.scene, item))
        except UserError as error:
            self._report(str(error))
        else:
            self._place_gizmo(item)

    def _place_gizmo(self, item: SceneObject) -> None:
        self._gizmo.position, self._gizmo.wxyz = item.transform.translation, edits.quaternion(item.transform)

    def _dragged(self) -> None:
        with self._filling():
            self._translation.value = tuple(self._gizmo.position.tolist())
            self._rotation.value = edits.rotation(self._gizmo.wxyz)
        item = self._item()
        if (moved := self._moved(item)).transform != item.transform:  # it may have been released in place
            self._session.change(scene=edits.with_object(self._session.view.scene, moved))

    def _moved(self, item: SceneObject) -> SceneObject:
        values = self._translation.value, self._rotation.value, self._scale.value
        return edits.with_transform(item, **dict(zip(("translation", "rotation", "scale"), values, strict=True)))

    def _with_material(self, item: SceneObject) -> SceneObject:
        """Change only colors that differ from the picker's: it has eight bits."""
        changed = {
            name: edits.from_picker(picker.value)
            for name, picker in (("diffuse", self._diffuse), ("specular", self._specular))
            if picker.value != edits.to_picker(getattr(item.material, name))
        }
        return edits.with_material(item, **changed, roughness=self._roughness.value)

    def _with_light(self, item: SceneObject) -> SceneObject:
        return edits.with_light(item, self._power.value, edits.from_picker(self._tint.value))


def add_reference(
    gui: viser.GuiApi, session: Session, settings: CyclesSettings, executor: Executor, report: Report
) -> None:
    """Add path tracing in the background, and comparison with the reference."""
    with gui.add_folder("Path-traced reference"):
        trace = gui.add_button(f"Path-trace this view ({settings.samples} samples)")
        share = gui.add_slider("Wipe", min=0.0, max=1.0, step=0.01, initial_value=session.view.share)
        status = gui.add_markdown("None yet.")

    def start(_: object) -> None:
        view, trace.disabled, status.content = session.view, True, "Path tracing …"
        size = session.pacing.size(view.longer_side, view.aspect)
        executor.submit(path_trace, view.scene, view.camera, size, settings).add_done_callback(finish)

    def finish(future: Future[Reference]) -> None:
        trace.disabled = False
        try:
            session.change(reference=future.result())
        except UserError as error:
            status.content = "None yet."
            report(str(error))

    def update_status(drawn: Drawn) -> None:
        reference = session.view.reference
        if reference and not trace.disabled:
            of = "" if drawn.is_compared or session.view.share == 1 else ", of another view"
            status.content = f"Path-traced in {reference.seconds:.1f} s{of}."

    trace.on_click(start)
    share.on_update(lambda _: session.change(share=share.value))
    session.on_draw(update_status)


def add_saving(client: viser.ClientHandle, session: Session) -> None:
    """Add downloads: the picture as PNG, and the edited scene with the visitor's camera."""
    with client.gui.add_folder("Save"):
        picture, scene = client.gui.add_button("Picture (PNG)"), client.gui.add_button("Scene")

    def send_picture(_: object) -> None:
        stream = io.BytesIO()
        Image.fromarray(session.newest.picture).save(stream, format="png")
        client.send_file_download(f"{as_file_name(session.view.scene.name)}.png", stream.getvalue())

    picture.on_click(send_picture)
    scene.on_click(lambda _: client.send_file_download(*scene_file(session.view.scene, camera_of(client))))


def scene_file(scene: Scene | PackedScene, camera: Camera) -> tuple[str, bytes]:
    """Return name and content of a file with the scene and this camera: a zip file of JSON and meshes, or H5."""
    stem = as_file_name(scene.name)
    with tempfile.TemporaryDirectory() as folder:
        if not fits_json(scene):
            return f"{stem}.h5", save_scene(pack(scene).seen_by([camera]), Path(folder) / "scene.h5").read_bytes()
        save_scene(Scene(name=scene.name, objects=scene.objects, cameras=(camera,)), Path(folder) / f"{stem}.json")
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(path for path in Path(folder).rglob("*") if path.is_file()):
                archive.write(file, file.relative_to(folder))
        return f"{stem}.zip", stream.getvalue()
