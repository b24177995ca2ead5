"""What people and files give, checked once where it comes in."""
