"""Scene files in and out: RenderFormer's JSON and H5, glTF, OBJ with MTL, PLY and STL.

Begin with `loading`, which chooses a reader and says what happens after it. Readers of other programs' files give an
`imported_scene`; `framing`, `light_rig` and `grouping` make a scene of that as networks have seen scenes. `limits`
holds for all that comes from outside.

The readers are our own: libraries for meshes drop what a renderer needs of a file (emissive strength, lights, cameras,
specular, ior) and believe what it says of itself, in counts and in names of other files.
"""
