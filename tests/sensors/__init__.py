"""Tests of the sensors package; real lines where a line matters."""
