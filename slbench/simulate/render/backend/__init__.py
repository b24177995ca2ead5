"""Which of Mitsuba's variants runs here, and with which LLVM."""
