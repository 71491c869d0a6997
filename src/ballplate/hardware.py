"""Hardware of one's own: derive from ``Hardware``, and name the class in a rig file as ``backend``.

`docs/your-rig.md` leads from unpacking to a run.
"""

from twin.devices.own import Hardware, Reading

__all__ = ["Hardware", "Reading"]
