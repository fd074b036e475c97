"""Scene files: RenderFormer's JSON and H5, glTF, OBJ with MTL, PLY and STL.

`loading` chooses a reader. Readers of other programs' files return an `imported_scene`, which `fitting` turns into a
scene like those networks are trained on. `limits` bounds everything that comes from outside.
"""
