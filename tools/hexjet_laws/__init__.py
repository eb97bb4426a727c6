"""Rate loops of the literature beside the paper's, each written against the names that users write against."""
