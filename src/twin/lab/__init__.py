"""Labs: what is asked of a student, each on a rig of their own, and how an answer is judged."""
