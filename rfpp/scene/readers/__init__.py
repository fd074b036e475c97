"""Scenes of other programs: glTF, OBJ with MTL, PLY and STL, framed and lit as networks have seen scenes."""
