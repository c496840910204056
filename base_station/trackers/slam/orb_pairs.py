"""Which pairs of places ORB's 256 bits compare, px from the corner before it is turned.

They were chosen from many for bits that vary and do not depend on each other (Rublee et al., "ORB", ICCV 2011, section
4.3). These are the ones of OpenCV, so that descriptors and vocabularies of others can be used; they were read off its
answers to pictures of single dots, and a test holds both together.
"""

from __future__ import annotations

import numpy as np

_LETTERS = (
    "vkwsrpubcwfpubzapapzogotldljaacfakbexrywaffecuezuuztjiknapbkengszhzmktlzhajfyazfrusoskxkqgtzfghllymdazfxgqikjpku"
    "dbhysbtgshumonriwyyarurzpmrrjblufigdrywznfoaalfpkllqhwjevzxunwoquiydahcnxuzohkhzxezjavfbanfjqquvsuxgmuobqdstpjqd"
    "anasagbzaqcvgzjutdzvemghlinzbsgsqdvaggjsklmgpwsccaiamtnmskspjajzehetbdfjxpzkuzzzgahsjwkrumzpgtioaybskulhufzgagcb"
    "okzzphqnjqlamaowuovhomqzwoztmemqaadsuuxzzizwtquysatxpbpqqvrhptzawbxqfrgwczjhozpfteujpqqltqynqkvfuvwqcihjdyixifkz"
    "dsenvmzhrhtcdzfurltulnlzifipuhxzeaffiailvfwaecenofolujwolomjyhzcbehrquuzssxvnjpvezianupzmpousyueqstfajfwiwkkjgkb"
    "tsvngthzatilodqxrovjllpapbzzlanhrowqhdkikamouszcrlsgaweiuovtufutgjgofygfatbfprqwxizqhihuvkwfpbpvcldqbagecndiskyv"
    "lamzmfnwacbidldykwlapkqpeajnjtkdjzlghcjwtktyayisyyztuizlmznujfklgohuabfaglhffsheimjsaufxossaonxawzxmsfxemyoaekhp"
    "mdozaofdvcxhpaqhuazeddigdffarhvsqzvajpkksaxbrasmewjqnqqebohoqprfdddwvazzfbhippquxtyftvvbgxhskekwmamskgkrflfqrpzz"
    "piqyteyaqmuzymzrknktrcrzpjpodhfoaucoazcatnyanmoraqelevhkahflsevxpuqemhmmwsylykzfqnqsmrnxqhrsandssvzyvwwhujvbdrdw"
    "uqzrwgxlunzlmhnc"
)
"""x and y of a pair's first and second place, one letter a number: n is 0."""

PAIRS = np.frombuffer(_LETTERS.encode(), np.uint8).astype(np.int8).reshape(256, 2, 2) - np.int8(ord("n"))
"""(256, 2, 2) int8 px: pairs, of two places, x and y. Bit k is set where the second place is the brighter one."""
