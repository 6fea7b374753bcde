"""Maps of the static scene: the model's own answers where they can be believed, its motion around them elsewhere."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from decomo_runtime.dense_maps import DenseMap, identity
from decomo_runtime.scene_maps import continued

HEIGHT, WIDTH = 20, 34


def test_what_is_near_an_object_hidden_or_far_off_does_not_count() -> None:
    """The scene is 2 pixels to the right of where its motion has it; a model errs by 1 more near an object, among what
    is hidden, and by 20 in one place.
    """
    base = identity(HEIGHT, WIDTH).places
    answered = base + np.float32([2, 0])
    visible, wanted = np.ones((HEIGHT, WIDTH), np.float32), np.ones((HEIGHT, WIDTH), bool)
    near, hidden, far = (slice(4, 8), slice(5, 12)), (slice(12, 16), slice(20, 28)), (slice(2, 3), slice(25, 26))
    wanted[near], visible[hidden] = False, 0.5
    answered[near] += 1
    answered[hidden] += 1
    answered[far] += 20
    found = continued(base, DenseMap(answered, visible), wanted, agreed=5.0)
    assert_allclose(found.places, base + np.float32([2, 0]), atol=0.05)
    assert (found.visible == 1).all()
