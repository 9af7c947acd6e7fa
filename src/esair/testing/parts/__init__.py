"""Fakes of parts that can be bought: they speak the protocol of the real one."""
