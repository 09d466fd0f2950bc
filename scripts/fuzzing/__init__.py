"""Broken inputs for navbake's readers, made from good ones, and what is done with each."""
