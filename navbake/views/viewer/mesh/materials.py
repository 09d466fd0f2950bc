"""The colours and textures of a model's geoms, as MuJoCo's own viewers have them."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.types import Int

RGB, RGBA = 1, 7  # mjtTextureRole: which textures of a material are its colour
FLAT_TEXTURE = 0  # mjtTexture: a picture, not the six sides of a cube
NO_COLOR = np.float32(0.5)  # rgba of a geom that states none: 0.5, 0.5, 0.5, 1


class Look(NamedTuple):
    """How geoms look, by geom id.

    Attributes:
        rgba: as MuJoCo has it, 0 to 1, shape (n, 4).
        plain: the same as linear light, times the mean of the texture, if there is one.
        textured: as linear light, for triangles that lie on their texture.
        texture: MuJoCo's id of a texture that meshes with coordinates lie on, -1 for none.
    """

    rgba: NDArray[np.float32]
    plain: NDArray[np.float32]
    textured: NDArray[np.float32]
    texture: Int


def find_looks(model: Any) -> Look:
    """How the geoms of a mujoco.MjModel look.

    A geom with a material has the material's colour, unless it states one of its own.
    """
    rgba = np.array(model.geom_rgba, dtype=np.float32).reshape(-1, 4)
    material = np.array(model.geom_matid, dtype=np.int64)
    states_none = (rgba == [NO_COLOR, NO_COLOR, NO_COLOR, 1]).all(axis=1)
    taken = (material >= 0) & states_none
    texture = np.full(len(rgba), -1, dtype=np.int64)
    if model.nmat:
        rgba[taken] = model.mat_rgba[material[taken]]
        ids = np.asarray(model.mat_texid).reshape(model.nmat, -1)
        own = np.where(ids[:, RGB] >= 0, ids[:, RGB], ids[:, RGBA])
        texture = np.where(material >= 0, own[material], -1)
    textured = to_linear(rgba)
    plain = textured.copy()
    for one in np.unique(texture[texture >= 0]).tolist():
        mean = read_texture(model, one)[..., :3].reshape(-1, 3).mean(axis=0) / 255
        plain[texture == one, :3] *= to_linear(mean)
    flat = np.isin(texture, np.flatnonzero(np.asarray(model.tex_type) == FLAT_TEXTURE))
    return Look(rgba, plain, textured, np.where(flat, texture, -1))


def read_texture(model: Any, texture: int) -> NDArray[np.uint8]:
    """A texture's picture, shape (height, width, 3 or 4), its upper row first."""
    height, width = int(model.tex_height[texture]), int(model.tex_width[texture])
    channels = int(model.tex_nchannel[texture])
    first = int(model.tex_adr[texture])
    flat = np.asarray(model.tex_data[first : first + height * width * channels])
    picture = flat.reshape(height, width, channels)
    return np.repeat(picture, 3, axis=2) if channels == 1 else picture


def to_linear(color: NDArray[Any]) -> NDArray[np.float32]:
    """Linear light of colours as screens take them (sRGB), shape (..., 3 or 4); opacity stays."""
    color = np.asarray(color, dtype=np.float32)
    linear = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    if color.shape[-1] == 4:
        linear[..., 3] = color[..., 3]
    return linear.astype(np.float32)
