"""Systems: masses, springs, damping, noise, contacts, and the processes that follow from them."""
