"""The mechanism in real time, driven by a person in a browser window."""
