"""How bounders of every kind are pickled and copied: as what a file of theirs holds, from which the class makes them anew."""

import copy

__all__ = ["PicklableBounder"]


class PicklableBounder:
    """Pickles and copies by its class's own constructor, which checks and copies all numbers: no copy shares memory with another."""

    def __reduce__(self):
        made = type(self), type(self.domain), self.domain.to_dict(), self.tensors, self.sizes, self._device
        return _remade, (*made, self.threshold, self.certificate, self.info, self.frame)


def _remade(kind, domain, numbers, tensors, sizes, device, threshold, certificate, info, frame):
    bounder = kind(domain.from_dict(numbers), tensors, copy.deepcopy(sizes), device)
    bounder.freeze(threshold, certificate).info = copy.deepcopy(info)
    bounder.frame = frame
    return bounder
