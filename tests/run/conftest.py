"""What tests of runs may use."""

from command_line import ballplate  # noqa: F401  a fixture
