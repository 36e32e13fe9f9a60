"""Measurements on scenes that training never drew, and the tables and figures made of them."""
