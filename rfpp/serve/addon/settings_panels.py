"""Settings, and where they are."""

from __future__ import annotations

import bpy

from .client import Server, ServerError

ENGINE = "RFPP"
_ADDRESS = "http://127.0.0.1:8700"


class RfppSettings(bpy.types.PropertyGroup):
    """Of a scene."""

    light_samples: bpy.props.IntProperty(
        name="Light Samples", default=16, min=1, max=4096,
        description="Shadow rays per light and pixel, and rays into reflections: less noise",
    )  # fmt: skip
    supersampling: bpy.props.IntProperty(
        name="Supersampling", default=2, min=1, max=8,
        description="Points along each side of a pixel at which light is computed: smooth outlines",
    )  # fmt: skip
    viewport_pixels: bpy.props.IntProperty(
        name="Viewport Pixels", default=256, min=64, max=4096,
        description="Along the longer side of the picture in the viewport",
    )  # fmt: skip


class RfppPreferences(bpy.types.AddonPreferences):
    """Of this machine: a file from someone else must not choose where scenes are sent."""

    bl_idname = __package__

    address: bpy.props.StringProperty(
        name="Server", default=_ADDRESS, description="Where `rfpp serve` runs: an address of this machine"
    )

    def draw(self, context) -> None:
        """In Blender's preferences."""
        self.layout.prop(self, "address")


class RfppTest(bpy.types.Operator):
    """Ask the server for its name."""

    bl_idname = "rfpp.test_server"
    bl_label = "Test Server"

    def execute(self, context) -> set[str]:
        """Reports what it says."""
        try:
            about = Server(address()).about()
        except ServerError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"The server at {address()} renders with {about['network']}")
        return {"FINISHED"}


class RfppPanel(bpy.types.Panel):
    """In the properties of the render."""

    bl_idname = "RENDER_PT_rfpp"
    bl_label = "rfpp"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"
    COMPAT_ENGINES = {ENGINE}  # noqa: RUF012 (Blender's)

    @classmethod
    def poll(cls, context) -> bool:
        """Whether it is shown."""
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context) -> None:
        """The panel."""
        layout, settings = self.layout, context.scene.rfpp
        layout.use_property_split = True
        row = layout.row(align=True)
        if (preferences := _preferences()) is not None:
            row.prop(preferences, "address")
        row.operator(RfppTest.bl_idname, text="", icon="FILE_REFRESH")
        column = layout.column(align=True)
        column.prop(settings, "light_samples")
        column.prop(settings, "supersampling")
        layout.prop(settings, "viewport_pixels")


def address() -> str:
    """Of the server."""
    preferences = _preferences()
    return _ADDRESS if preferences is None else preferences.address


def _preferences() -> RfppPreferences | None:
    added = bpy.context.preferences.addons.get(__package__)
    return None if added is None else added.preferences


_CLASSES = (RfppSettings, RfppPreferences, RfppTest, RfppPanel)
_EXCLUDED = {"VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes", "RENDER_PT_freestyle"}
#: Nodes of materials are edited in these, whichever engine renders.
_INCLUDED = {"EEVEE_MATERIAL_PT_context_material", "EEVEE_MATERIAL_PT_surface"}


def _of_blender() -> list[type]:
    """Blender's own panels that make sense with this engine."""
    return [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if (name := panel.__name__) in _INCLUDED
        or ("BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ()) and name not in _EXCLUDED)
    ]


def register() -> None:
    for item in _CLASSES:
        bpy.utils.register_class(item)
    bpy.types.Scene.rfpp = bpy.props.PointerProperty(type=RfppSettings)
    for panel in _of_blender():
        panel.COMPAT_ENGINES.add(ENGINE)


def unregister() -> None:
    for panel in _of_blender():
        panel.COMPAT_ENGINES.discard(ENGINE)
    del bpy.types.Scene.rfpp
    for item in reversed(_CLASSES):
        bpy.utils.unregister_class(item)
