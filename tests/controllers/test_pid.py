import numpy as np
import pytest

from controllers.analysis import linear_law
from controllers.ballplate import BallPlate
from controllers.classical import Pid
from controllers.references import Hold

GAINS = {"kp": 5.0, "ki": 2.0, "kd": 3.0, "filter": 0.05, "plate": (90.0, 18.0)}


@pytest.mark.parametrize("s", [0.1j, 1j, 8j, 0.5 + 2j])
def test_from_position_to_effort_it_is_a_pid_with_a_filtered_derivative(s):
    A, B, C, D, _ = linear_law(Pid(**GAINS))
    transfer = C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D
    pid = 5.0 + 2.0 / s + 3.0 * s / (1 + 0.05 * s)
    k1 = BallPlate().k1
    expected = np.zeros((2, 8), complex)
    expected[0, [0, 2, 3]] = -90.0 * pid / k1, -90.0, -18.0
    expected[1, [4, 6, 7]] = 90.0 * pid / k1, -90.0, -18.0
    np.testing.assert_allclose(transfer, expected, rtol=1e-5, atol=1e-5)


def test_its_integral_stops_where_the_angle_is_at_its_limit_and_goes_back_at_once():
    law, x, q = Pid(angle=5.0, kd=0.0), np.zeros((1, 8)), np.zeros((1, 4))
    q[0, 0] = 10.0
    for way, rate in ((0.2, 0.0), (-0.2, -0.2)):
        assert law.memory_rate(0.0, x, Hold(x=way), q)[0, 0] == pytest.approx(rate)
    assert law.memory_rate(0.0, x, Hold(x=0.05), 0 * q)[0, 0] == pytest.approx(0.05)
    u = law.control(0.0, x, Hold(x=0.2), q)
    np.testing.assert_allclose(u, [[144.0 * np.radians(5.0), 0.0]], atol=1e-12)
