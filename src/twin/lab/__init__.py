"""Work of others, graded: answers to labs on rigs of their own, laws on the benchmark."""
