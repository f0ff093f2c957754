"""The place of a target on the skin is found once, however many views ask for it."""

import numpy as np

from skincal.mesh import surface as surface_module
from skincal.mesh.surface import MAX_KEPT_SKIN_POINTS, contact_point, make_surface, point_on_skin

SQUARE = make_surface(
    np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]])
)
UP = np.array([0.0, 0.0, 1.0])


def test_the_same_question_is_answered_once_and_each_answer_is_the_caller_s_own(monkeypatch):
    asked = []
    monkeypatch.setattr(
        surface_module, "contact_point", lambda *question: asked.append(question[1]) or contact_point(*question)
    )
    places = [np.array([0.1 * k, 0.2, 0.3]) for k in range(MAX_KEPT_SKIN_POINTS + 2)]
    for place in places:
        for _ in range(3):
            found = point_on_skin(SQUARE, place, UP)
            np.testing.assert_allclose(found, place * (1.0, 1.0, 0.0), atol=1e-15)
            found += 1.0
    assert len(asked) == len(places)
    # Another direction is another question.
    np.testing.assert_allclose(point_on_skin(SQUARE, places[-1], np.array([0.6, 0.0, 0.8])), [0.675, 0.2, 0.0], atol=1e-15)
