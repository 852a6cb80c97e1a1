"""Record which random numbers a chip draws, and by which code (csstsim.base.rng and csstsim.base.counter).

As a program, `NUMBA_DISABLE_JIT=1 python randomness.py FOLDER`, it runs small but complete chips in pure Python, where
every word of a counter is seen, and prints the faults as JSON, {exposure: [fault, ...]}, with the records.

The name of a stream (its whole key) is used once per exposure if it is the exposure's; a fixed pattern (of the chip, a
channel, the camera) may be drawn again, but by one line of code only. A word of a counter is used once, and so is each
of its halves. Exceptions are declared in SHARED.
"""

import json
import sys
import warnings
from collections import Counter, defaultdict
from pathlib import Path

from csstsim.base import counter, rng

SOURCE = Path(rng.__file__).parents[1]
ONCE = {"exposure", "object", "brick"}  # first words of keys whose numbers are for one draw
SHARED = {
    # {what: reason}. Of names: the last word of the key. Of words: the functions that ask, in the order of the alphabet
    "prnu": "one pattern: thinned out of counted light, multiplied into the expected, divided out by calibration",
    ("_count", "from_psf"): "from_psf takes the lower half of a word, the loss on the pixel the upper one",
    "object_keys": "objects of one id begin with one key, from which all but the first get another",
}


class Recorder:
    """Records from `begin` on; `faults()` says what was used for two things."""

    def __init__(self):
        self.begin()

    def begin(self):
        self.names, self.lasting = defaultdict(Counter), set()
        self.words, self.halves = defaultdict(Counter), defaultdict(Counter)

    def watch_names(self, set_):
        """Put the recorder into csstsim.base.rng by `set_`(module, name, value), as monkeypatch.setattr."""
        begun, digest, counter_key, first, whole = rng._begun, rng._digest, rng._counter_key, {}, {}

        def began(*words):
            hashed = begun(*words)
            first[hashed.digest()] = words
            return hashed

        def asked(hashed, *words):
            key, found = (*first[hashed.digest()], *words), digest(hashed, *words)
            self.names[key][_site()] += 1
            whole[found] = key
            return found

        def keyed(found):
            key = counter_key(found)
            if whole[found][1] not in ONCE:
                self.lasting.add(int(key))
            return key

        set_(rng, "_begun", began)
        set_(rng, "_digest", asked)
        set_(rng, "_counter_key", keyed)

    def watch_words(self):
        """Put the recorder into csstsim.base.counter, before any module takes its functions."""
        word, halves = counter.word, {name: getattr(counter, name) for name in ("high", "low", "unit")}

        def asked(key, count):
            self.words[int(key), int(count)][sys._getframe(1).f_code.co_name] += 1
            bits = word(key, count)
            if int(key) in self.lasting:  # what is made of it lasts as long: a trap's place, the key of a column
                self.lasting.add(int(bits))
            return bits

        def used(name):
            def half(bits):
                for part in ("high", "low") if name == "unit" else (name,):
                    self.halves[int(bits), part][sys._getframe(1).f_code.co_name] += 1
                return halves[name](bits)

            return half

        counter.word = asked
        for name in halves:
            setattr(counter, name, used(name))

    def faults(self):
        """Return a line for each number that is used for two things."""
        found = []
        for key, sites in self.names.items():
            twice = sites.total() > 1 if key[1] in ONCE else len(sites) > 1
            if twice and key[-1] not in SHARED:
                found.append(f"stream {'/'.join(map(str, key))} is asked for by {dict(sites)}")
        for (key, count), sites in self.words.items():
            again = any(sites[name] > 1 for name in sites if name not in SHARED) and key not in self.lasting
            if again or (len(sites) > 1 and tuple(sorted(sites)) not in SHARED):
                found.append(f"word {count} of the key {key:x} is asked for by {dict(sites)}")
        for (bits, part), sites in self.halves.items():
            if sites.total() > 1 and bits not in self.lasting:
                found.append(f"the {part} half of a word is used by {dict(sites)}")
        return sorted(set(found))


def _site():
    """The line that asks: the first frame that is neither base.rng nor a function that only passes a name on."""
    frame = sys._getframe(2)
    while Path(frame.f_code.co_filename) == SOURCE / "base" / "rng.py" or frame.f_code.co_name == "<lambda>":
        frame = frame.f_back
    return f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}"


def scenes(folder):
    """Yield (name, campaign opened) of the exposures that are recorded, of chips with many cosmic rays."""
    import yaml

    from csstsim.base.shipped import SHIPPED
    from csstsim.campaign.opened import OpenCampaign
    from support.mini_campaign import write_campaign, write_scene

    def opened(file):
        rays = file.parent / "instrument" / "cosmic_rays.yaml"
        numbers = yaml.safe_load(rays.read_text())
        numbers["number"]["rate"]["value"] = 1e-5  # tracks / s / pixel
        rays.write_text(yaml.safe_dump(numbers))
        return OpenCampaign(file)

    small = {"nx": 64, "ny": 64, "channel_nx": 8, "channel_ny": 32}
    lists = SHIPPED / "observations"
    options = {
        "CTE_effect": {"density_scale": 1.0, "serial": True}, "nonlinearity": {"nonlinearity_16channel": True},
        "sky_background": {"enable_straylight_model": True}, "cosmic_rays": {"save_cosmic_image": True},
    }  # fmt: skip
    everything = yaml.safe_load((lists / "science_paper.yaml").read_text())
    for layer in everything["layers"]:
        [keyword] = layer
        layer[keyword] = (layer[keyword] or {}) | options.get(keyword, {})
    (folder / "everything.yaml").write_text(yaml.safe_dump(everything))
    places = [20.0, 40.0, 25.0, 44.0], [30.0, 20.0, 45.0, 44.0]
    for name, chip, file in (
        ("imaging", 9, lists / "science.yaml"),
        ("grating, every option", 29, folder / "everything.yaml"),
    ):
        own = folder / name
        own.mkdir(exist_ok=True)
        changes = {"chip": chip, "geometry": small, "observations": {"SCIE": str(file)}}
        yield name, opened(write_scene(own, "Twins", *places, 22.5, **changes))
    for kind, seconds in (("BIAS", 0), ("DARK", 150), ("FLAT", 150)):
        own = folder / kind
        own.mkdir(exist_ok=True)
        row = f"10300000001,{kind},0,0,0,2027-06-01T00:01:00,{seconds}"
        select = {"types": [kind], "chips": [9]}
        yield kind, opened(write_campaign(own, [row], geometry=small, select=select))


def main(folder):
    """Record each of the scenes, whose PSF sets are there; print {name: {faults, names, words}} as JSON."""
    warnings.simplefilter("ignore")  # whole numbers of numpy that wrap, as they are meant to
    recorder, found = Recorder(), {}
    recorder.watch_words()
    recorder.watch_names(setattr)
    from csstsim.stages import chip as chip_stage

    for name, run in scenes(folder):
        recorder.begin()
        chip_stage.simulate(run, run.jobs[0], log=str)
        askers = {site for sites in recorder.words.values() for site in sites}
        found[name] = {
            "faults": recorder.faults(), "names": sorted({str(key[-1]) for key in recorder.names}),
            "askers": sorted(askers), "words": len(recorder.words),
        }  # fmt: skip
    print(json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
