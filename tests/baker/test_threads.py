"""How many threads a bake may be told to run on."""

import numba
import numpy as np
import pytest

import navbake
from navbake.baker.threads import limit_threads
from navbake.errors import ConfigError


@pytest.mark.parametrize("count", ["2", 1.5, True, 0, -1, [], "x"], ids=repr)
def test_what_is_no_number_of_threads(tmp_path, count):
    with (
        pytest.raises(ConfigError, match="expected a number of threads >= 1, got"),
        limit_threads(count),
    ):
        pass
    scene = tmp_path / "scene.xml"
    scene.write_text('<mujoco><worldbody><geom type="box" size="1 1 .1"/></worldbody></mujoco>')
    with pytest.raises(ConfigError, match="expected a number of threads >= 1, got"):
        navbake.bake(scene, threads=count)


@pytest.mark.parametrize("count", [1, np.int64(1), 10**30, None], ids=repr)
def test_numbers_of_threads(count):
    before = numba.get_num_threads()
    with limit_threads(count):
        assert numba.get_num_threads() == (1 if count == 1 else before)
    assert numba.get_num_threads() == before
