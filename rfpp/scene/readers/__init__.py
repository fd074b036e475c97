"""Scenes of other programs: glTF, OBJ with MTL, PLY and STL, framed and lit as networks have seen scenes.

Begin with `rfpp.scene.loading`, which chooses a reader and says what happens after it; `imported` is what every reader
gives; `framing`, `light_rig` and `grouping` make a scene of that.

The readers are our own: libraries for meshes drop what a renderer needs of a file (emissive strength, lights, cameras,
specular, ior) and believe what it says of itself, in counts and in names of other files.
"""
