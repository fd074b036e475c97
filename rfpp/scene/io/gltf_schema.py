"""The part of glTF 2.0's JSON that is read, with types and ranges; what is not named here is ignored."""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.limits import MAX_ENTRIES
from rfpp.scene.spec import first_problem

Entry = TypeVar("Entry")
Several = Annotated[list[Entry], Field(max_length=MAX_ENTRIES)]
Index = Annotated[int, Field(ge=0, lt=2**31)]
Size = Annotated[int, Field(ge=0, lt=2**53)]
Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(ge=0)]
Vector = tuple[float, float, float]
Matrix = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float, float, float, float, float
]


class _Entry(BaseModel):
    model_config = ConfigDict(alias_generator=to_camel, frozen=True, allow_inf_nan=False)


class Accessor(_Entry):
    buffer_view: Index | None = None
    byte_offset: Size = 0
    component_type: int
    normalized: bool = False
    count: Annotated[Size, Field(ge=1)]
    type: str
    sparse: Any = None


class BufferView(_Entry):
    buffer: Index
    byte_offset: Size = 0
    byte_length: Size
    byte_stride: Annotated[int, Field(ge=1, le=252)] | None = None


class Buffer(_Entry):
    uri: str | None = None
    byte_length: Size


class Image(_Entry):
    uri: str | None = None
    buffer_view: Index | None = None


class _WebP(_Entry):
    source: Index


class _TextureExtensions(_Entry):
    webp: _WebP | None = Field(None, alias="EXT_texture_webp")


class Texture(_Entry):
    source: Index | None = None
    extensions: _TextureExtensions = _TextureExtensions()


class TextureTransform(_Entry):
    """u, v → offset + R · scale · (u, v), R counter-clockwise in the picture."""

    offset: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)
    tex_coord: Index | None = None


class _TextureInfoExtensions(_Entry):
    transform: TextureTransform | None = Field(None, alias="KHR_texture_transform")


class TextureInfo(_Entry):
    index: Index
    tex_coord: Index = 0
    extensions: _TextureInfoExtensions = _TextureInfoExtensions()


class MetallicRoughness(_Entry):
    base_color_factor: tuple[Share, Share, Share, Share] = (1.0, 1.0, 1.0, 1.0)
    base_color_texture: TextureInfo | None = None
    metallic_factor: Share = 1.0
    roughness_factor: Share = 1.0
    metallic_roughness_texture: TextureInfo | None = None


class _EmissiveStrength(_Entry):
    emissive_strength: Positive = 1.0


class _RefractiveIndex(_Entry):
    ior: Positive = 1.5


class _Specular(_Entry):
    specular_factor: Share = 1.0
    specular_color_factor: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)


class _Transmission(_Entry):
    transmission_factor: Share = 0.0


class _DiffuseTransmission(_Entry):
    diffuse_transmission_factor: Share = 0.0


class _MaterialExtensions(_Entry):
    emissive_strength: _EmissiveStrength = Field(_EmissiveStrength(), alias="KHR_materials_emissive_strength")
    ior: _RefractiveIndex = Field(_RefractiveIndex(), alias="KHR_materials_ior")
    specular: _Specular = Field(_Specular(), alias="KHR_materials_specular")
    transmission: _Transmission = Field(_Transmission(), alias="KHR_materials_transmission")
    diffuse_transmission: _DiffuseTransmission = Field(
        _DiffuseTransmission(), alias="KHR_materials_diffuse_transmission"
    )


class Material(_Entry):
    name: str = ""
    pbr_metallic_roughness: MetallicRoughness = MetallicRoughness()
    normal_texture: Any = None
    emissive_factor: tuple[Positive, Positive, Positive] = (0.0, 0.0, 0.0)
    emissive_texture: TextureInfo | None = None
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: Positive = 0.5
    extensions: _MaterialExtensions = _MaterialExtensions()


class Primitive(_Entry):
    attributes: Annotated[dict[str, Index], Field(max_length=100)]
    indices: Index | None = None
    material: Index | None = None
    mode: int = 4
    targets: Several[Any] = Field(default_factory=list)
    extensions: Annotated[dict[str, Any], Field(max_length=100)] = Field(default_factory=dict)


class Mesh(_Entry):
    name: str = ""
    primitives: Several[Primitive]


class Skin(_Entry):
    joints: Several[Index]
    inverse_bind_matrices: Index | None = None


class _Perspective(_Entry):
    yfov: Annotated[float, Field(gt=0, lt=3.14159)]
    aspect_ratio: Annotated[float, Field(gt=0)] | None = None


class Camera(_Entry):
    type: str
    perspective: _Perspective | None = None


class PunctualLight(_Entry):
    name: str = ""
    type: str
    color: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    intensity: Positive = 1.0


class _LightOfNode(_Entry):
    light: Index


class _NodeExtensions(_Entry):
    light: _LightOfNode | None = Field(None, alias="KHR_lights_punctual")
    instancing: Any = Field(None, alias="EXT_mesh_gpu_instancing")


class Node(_Entry):
    name: str = ""
    mesh: Index | None = None
    camera: Index | None = None
    skin: Index | None = None
    children: Several[Index] = Field(default_factory=list)
    matrix: Matrix | None = None
    translation: Vector = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    scale: Vector = (1.0, 1.0, 1.0)
    extensions: _NodeExtensions = _NodeExtensions()


class SceneEntry(_Entry):
    name: str = ""
    nodes: Several[Index] = Field(default_factory=list)


class _Lights(_Entry):
    lights: Several[PunctualLight] = Field(default_factory=list)


class _Extensions(_Entry):
    lights: _Lights = Field(_Lights(), alias="KHR_lights_punctual")


class _Asset(_Entry):
    version: str


class Document(_Entry):
    asset: _Asset
    extensions_required: Several[str] = Field(default_factory=list)
    extensions_used: Several[str] = Field(default_factory=list)
    scene: Index | None = None
    scenes: Several[SceneEntry] = Field(default_factory=list)
    nodes: Several[Node] = Field(default_factory=list)
    meshes: Several[Mesh] = Field(default_factory=list)
    materials: Several[Material] = Field(default_factory=list)
    textures: Several[Texture] = Field(default_factory=list)
    images: Several[Image] = Field(default_factory=list)
    accessors: Several[Accessor] = Field(default_factory=list)
    buffer_views: Several[BufferView] = Field(default_factory=list)
    buffers: Several[Buffer] = Field(default_factory=list)
    cameras: Several[Camera] = Field(default_factory=list)
    skins: Several[Skin] = Field(default_factory=list)
    animations: Several[Any] = Field(default_factory=list)
    extensions: _Extensions = _Extensions()


def parse_document(content: dict[str, Any]) -> Document:
    """Raises SceneError naming the first key that is missing, of another type or out of range."""
    try:
        document = Document.model_validate(content)
    except ValidationError as error:
        raise SceneError(f"{one_line(first_problem(error))}: export it again") from None
    if document.asset.version.split(".")[0] != "2":
        raise SceneError(f"glTF version '{one_line(document.asset.version)}' cannot be read: export glTF 2.0")
    return document
