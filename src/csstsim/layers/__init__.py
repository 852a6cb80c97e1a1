"""The layers of the paper's Appendix B, one module per keyword (lower case). No layer imports another."""
