"""The page of `navbake view`.

`view.py` serves it, `page.py` brings it up to date, `controls.py` and `texts.py` are its panel.
`exhibit.py` has what is chosen and what follows from that, without a browser; `scene_mesh.py` and
`overlay.py` turn scene and grid into triangles.
"""
