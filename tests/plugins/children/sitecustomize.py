"""Python-can in a process that a test starts has no reader of MDF logs: that takes it a second.

It imports asammdf with everything else where the package is installed. The tests of ``.mf4`` files
read them in the process of the tests; a process of its own may import asammdf by itself.
"""

import sys


class WithoutAsammdf:
    """Lets ``import asammdf`` fail while ``can.io.mf4`` is imported, as without the package."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == "asammdf":
            spec = getattr(sys.modules.get("can.io.mf4"), "__spec__", None)
            if getattr(spec, "_initializing", False):
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, WithoutAsammdf)
