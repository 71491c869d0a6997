"""What is identified of an axis of any rig, made by hand for the tests of what is read from it."""

from controllers.ballplate import BallPlate
from twin.identify.axis_identification import AxisIdentification


def axis_identification(*verdicts):
    """Verdicts alone, about a hollow ball: no predictions, notes or remarks."""
    return AxisIdentification(
        source="log",
        seconds=1.0,
        verdicts=verdicts,
        scores=(),
        predictions={},
        notes=(),
        extent="",
        remarks=(),
        factor=3 / 5,
        ball=BallPlate(),
    )
