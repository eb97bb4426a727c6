"""Rate loops of the literature beside the paper's, each written against the protocol that users write against."""
