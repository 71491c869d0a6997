from command_line import ballplate  # noqa: F401  a fixture
