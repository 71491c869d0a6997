"""What others hand in, judged: answers to labs on rigs of their own, laws on the benchmark."""
