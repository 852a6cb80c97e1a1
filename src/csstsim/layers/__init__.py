"""The layers of the paper's Appendix B, one module a keyword (lower case). No layer imports another."""
