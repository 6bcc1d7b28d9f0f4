"""By which names icon sets know our concepts, and which of their icons show something else than their name says."""

from __future__ import annotations

# fmt: off
ALSO_CALLED: dict[str, str] = {
    "dog": "sitting-dog", "leopard": "jaguar", "deer": "stag buck reindeer", "bison": "buffalo", "cow": "dairy-cow",
    "pig": "hog piglet", "boar": "wild-boar", "ram": "ram-profile", "sheep": "ewe lamb",
    "camel": "dromedary-camel dromedary two-hump-camel bactrian-camel", "elephant": "african-elephant",
    "rhinoceros": "rhino rhinoceros-horn", "hippopotamus": "hippo", "mouse": "seated-mouse", "hamster": "hampster",
    "rabbit": "bunny hare", "koala": "koala-bear", "panda": "giant-panda", "chicken": "hen", "rooster": "cock",
    "chick": "baby-chick front-facing-baby-chick frontfacingchick hatching-chick", "dove": "doveofpeace peace-dove",
    "eagle": "bald-eagle", "duck": "mallard", "owl": "barn-owl", "frog": "toad", "crocodile": "alligator croc",
    "turtle": "tortoise sea-turtle", "lizard": "gecko", "whale": "spouting-whale sperm-whale blue-whale",
    "seal": "sea-lion", "fish": "tropical-fish goldfish fish-one", "blowfish": "pufferfish", "lobster": "crawfish",
    "shrimp": "prawn", "squid": "giant-squid", "bee": "honeybee bumblebee", "beetle": "scarab-beetle bug-beetle",
    "ladybug": "lady-beetle ladybird", "spider": "tarantula long-legged-spider", "worm": "earthworm",
    "apple": "red-apple shiny-apple apple-one", "orange": "tangerine mandarin orange-one",
    "banana": "bananas peeled-banana", "watermelon": "watermelon-slice", "grapes": "grape grape-bunch",
    "blueberries": "blueberry", "cherries": "cherry", "peach": "nectarine", "kiwi": "kiwi-fruit",
    "eggplant": "aubergine", "avocado": "avocado-one", "lettuce": "leafy-green cabbage",
    "chili_pepper": "pepper hot-pepper chilli chili-mild chilli-pepper chili chili-hot", "bell_pepper": "paprika",
    "corn": "ear-of-corn maize earofmaize corn-cob sweetcorn", "olive": "olives", "potato": "potatoes",
    "sweet_potato": "roasted-sweet-potato yam", "mushroom": "toadstool fly-agaric mushroom-gills",
    "peanuts": "peanut", "croissant": "croissants",
    "bread": "loaf bread-loaf loaf-of-bread bread-slice sliced-bread toast",
    "baguette": "baguette-bread french-bread", "pancakes": "pancake", "cheese": "cheese-wedge cheese-slice",
    "egg": "eggs fried-egg egg-fried cracked-egg", "steak": "cut-of-meat raw-meat",
    "chicken_leg": "poultry-leg drumstick food-drumstick chicken-drumstick", "burger": "hamburger cheeseburger",
    "fries": "french-fries", "pizza": "pizza-slice full-pizza slice-of-pizza", "hot_dog": "food-hot-dog",
    "salad": "green-salad", "bento": "bento-box", "rice": "cooked-rice rice-bowl bowl-of-rice",
    "rice_ball": "onigiri", "curry": "curry-rice curryandrice", "ramen": "steaming-bowl noodles bowl-of-noodles",
    "spaghetti": "pasta noodle", "fried_shrimp": "tempura", "dumpling": "dumplings",
    "ice_cream": "soft-ice-cream ice-cream-cone ice-cream-bowl", "donut": "doughnut donuts",
    "cookie": "cookies biscuit cookie-one", "birthday_cake": "cake",
    "shortcake": "cake-slice strawberry-cake slice-of-cake cake-one", "cupcake": "muffin",
    "chocolate": "chocolate-bar", "candy": "sweets candies wrapped-sweet", "honey": "honey-pot honey-jar honey-one",
    "milk": "glass-of-milk milk-bottle bottle-of-milk milk-carton",
    "coffee": "hot-beverage coffee-cup cup-of-coffee coffee-mug",
    "tea": "teacup-without-handle teacup tea-drink cup-of-tea green-tea",
    "wine": "wine-glass wine-one glass-wine red-wine-glass red-wine",
    "cocktail": "cocktail-glass martini glass-cocktail martini-glass",
    "beer": "beer-mug beer-stein glass-mug beer-glass", "whiskey": "tumbler-glass",
    "champagne": "bottle-with-popping-cork champagne-bottle bottle-champagne champagne-cork",
    "juice_box": "beverage-box", "soda": "cup-with-straw soda-cup cup-straw soft-drink soda-can", "wrench": "spanner",
    "saw": "carpentry-saw hand-saw hacksaw", "scissors": "blackscissors scissor scissors-cut",
    "key": "old-key key-variant", "lock": "locked padlock lock-one", "magnet": "horseshoe-magnet", "bucket": "pail",
    "basket": "wicker-basket basket-one", "soap": "bar-of-soap soap-bar", "razor": "straight-razor",
    "mirror": "hand-mirror mirror-one", "bathtub": "bath tub", "bed": "bed-empty double-bed",
    "couch": "couch-and-lamp sofa", "chair": "chair-one", "door": "wooden-door closed-door door-closed",
    "window": "window-closed window-variant", "light_bulb": "bulb idea electric-bulb",
    "candle": "candles candlestick", "flashlight": "electrictorch", "book": "closed-book bookclosed red-book",
    "newspaper": "newspaper-folding", "pencil": "lowerleftpencil",
    "pen": "lowerleftpen ballpoint-pen fountain-pen lowerleftfountainpen", "paintbrush": "lowerleftpaintbrush brush",
    "crayon": "lowerleftcrayon", "ruler": "straight-ruler ruler-one",
    "mailbox":
        "closed-mailbox-with-raised-flag closedmailboxraised "
        "open-mailbox-with-raised-flag closed-mailbox-with-lowered-flag openmailboxraised",
    "package": "package-variant package-variant-closed parcel cardboard-box",
    "mobile_phone": "cellphone smartphone phone-portrait iphone mobile",
    "telephone": "blacktelephone phone-classic telephone-one old-phone",
    "laptop": "personalcomputer laptop-computer laptop-one", "keyboard": "keyboard-one",
    "computer_mouse": "onebuttonmouse mouse-one mouse-simple", "printer": "printer-one",
    "television": "tv television-classic tv-one retro-tv", "radio": "radio-one", "camera": "camera-one photo-camera",
    "microphone": "mic studio-microphone microphone-one", "headphones": "headphone",
    "battery": "battery-full full-battery", "electric_plug": "plug power-plug plug-one",
    "watch": "wristwatch watch-one", "alarm_clock": "alarm clock-alarm",
    "hourglass": "hourglass-done hourglass-not-done hourglassflowingsand hourglass-full sandglass timer-sand",
    "floppy_disk": "floppydisk2 floppy save diskette 3floppy", "compass": "compass-one", "map": "world-map",
    "globe":
        "globe-showing-europe-africa europeafricaglobe earth world "
        "americasglobe globe-showing-americas globe-showing-asia-australia asiaaustraliaglobe earth-globe",
    "car": "automobile car-side oncoming-automobile sedan", "taxi": "oncoming-taxi taxi-cab",
    "bus": "oncoming-bus bus-one", "fire_engine": "fire-truck", "police_car": "oncoming-police-car police-car-one",
    "truck": "delivery-truck delivery-van lorry articulated-lorry", "train": "locomotive steam-locomotive",
    "bicycle": "bike", "motorcycle": "motorbike motor-scooter", "airplane": "plane aeroplane",
    "rocket": "rocket-one rocketship", "sailboat": "boat", "canoe": "kayak",
    "umbrella": "umbrella-with-rain-drops umbrella-rain closed-umbrella umbrella-one", "crown": "queen-crown",
    "sunglasses": "darksunglasses", "shirt": "t-shirt mansshirt clothes-crew-neck", "jeans": "trousers",
    "coat": "jacket", "scarf": "scarves", "gloves": "glove mittens", "socks": "sock",
    "sneaker": "running-shoe sport-shoe shoe-sneaker sneakers", "boot": "womans-boot boots womans-boots",
    "high_heel": "high-heeled-shoe heels high-heel-shoe high-heels shoe-heel",
    "backpack": "school-backpack school-bag", "ring": "diamond-ring engagement-ring",
    "soccer_ball": "soccer football-soccer", "basketball": "basketball-ball", "baseball": "baseball-ball",
    "boxing_glove": "boxing boxing-gloves boxing-glove-surprise", "ice_skate": "ice-skates",
    "fishing_pole": "fishing-rod fishingpoleandfish", "guitar": "acoustic-guitar electric-guitar",
    "drum": "drum-with-drumsticks snare-drum drums", "teddy_bear": "toy-bear",
    "gift": "wrapped-gift present wrappedpresent gift-box",
    "die": "game-die dice dice-5 dice-five gamedice dice-six-faces-five perspective-dice-six-faces-random dice-6",
    "puzzle_piece": "puzzle jigsaw jigsaw-piece", "tree": "deciduous-tree oak", "palm_tree": "palm",
    "cactus": "saguaro", "tulip": "tulips", "sun": "sunny black-sun-with-rays clear-day sun-one", "star": "star-one",
    "snowman": "snowman-without-snow", "fire": "flame", "house": "home housebuilding home-one",
    "tent": "camping-tent tent-one", "castle": "europeancastle", "pill": "capsule pills", "syringe": "injection",
    "thermometer": "thermometer-one", "bandage": "adhesive-bandage band-aid sticking-plaster",
    "telescope": "spyglass", "test_tube": "test-tubes", "knife": "kitchen-knife hocho chefs-knife knife-variant",
    "spoon": "tablespoon", "coin": "coin-one", "credit_card": "credit-card-one", "trophy": "trophy-cup trophy-one",
    "medal": "sports-medal militarymedal 1st-place-medal medal-one", "bell": "church-bell bell-ring ringing-bell",
    "bomb": "round-bomb bomb-one unlit-bomb", "bow_and_arrow": "bow-arrow archery",
    "shopping_cart": "shopping-trolley cart shopping-cart-one",
    "traffic_light": "vertical-traffic-light traffic-lights horizontal-traffic-light",
    "yarn": "ball-of-yarn yarn-ball wool",}
"""Concept to further icon names: those of the Unicode characters, and what icon sets use instead."""

LOGOS_ALSO_CALLED: dict[str, str] = {
    "python": "python-colored", "firefox": "firefox-browser", "linux": "linux-tux", "go": "golang go-gopher",
    "vue": "vuejs vue-js", "react": "reactjs", "nodejs": "node-js node-dot-js nodedotjs", "chrome": "google-chrome",
    "vlc": "vlc-media-player videolan vlcmediaplayer", "mongodb": "mongo", "postgresql": "postgres pgsql",
    "arch_linux": "arch archlinux", "javascript": "js js-official", "typescript": "ts typescript-official",
    "kubernetes": "k8s", "rust": "rustlang", "git": "git-scm", "ubuntu": "ubuntu-linux",
}
"""The same for logos."""

CORRECTIONS: dict[str, dict[str, str | None]] = {
    "emojione": {"cricket": None},
    "emojione-mono": {"cricket": None},
    "noto-v1": {"cricket": None, "laptop": None},
    "emojione-v1": {"keyboard": None, "laptop": None, "window": None, "shield": None},
    "openmoji": {"apple": None, "pepper": None, "save": None},
    "devicon": {"go": None},
    "vscode-icons": {"file-type-go-gopher": None, "file-type-reactjs": None},
    "file-icons": {"kotlin": None, "php": None},
    "cib": {"node-js": None},
    "streamline": {"turkey": None},
    "fxemoji": {"keyboard": None, "sunglasses": None, "bath": None, "personalcomputer": None, "window": None},
    "game": {
        "ram": None, "pig-face": None, "spider-face": None, "olive": None, "squid": None, "squid-head": None,
        "bulb": None, "airplane": None, "palm": None, "guitar-head": None, "tree-face": None, "engagement-ring": None,
        "volcano": None, "boxing-glove-surprise": None, "champagne-cork": None,
        "perspective-dice-six-faces-random": None,
    },
    "mdi": {
        "mouse": "computer_mouse", "mouse-outline": "computer_mouse", "seal": None, "seal-outline": None,
        "cricket": None, "apple": None, "chili-mild": None, "chili-mild-outline": None, "pepper": None,
        "chocolate": None, "chocolate-outline": None, "whiskey": None, "package-outline": None, "honey-outline": None,
    },
    "tabler": {
        "mouse": "computer_mouse", "mouse-2": "computer_mouse", "mouse-filled": "computer_mouse", "cricket": None,
        "world-map": "globe", "capsule": None, "capsule-filled": None,
    },
    "phosphor": {
        "mouse": "computer_mouse", "mouse-fill": "computer_mouse", "seal": None, "seal-fill": None, "cricket": None,
        "cricket-fill": None,
    },
    "streamline-color": {
        "mouse": "computer_mouse", "mouse-flat": "computer_mouse", "apple": None, "apple-flat": None,
    },
    "lucide": {"mouse": "computer_mouse", "radio": None, "pen": None},
    "icon-park": {
        "mouse": "computer_mouse", "turkey": None, "chicken": None, "seal": None, "apple": None, "envelope": None,
        "pie": None, "ring": None, "anchor": None, "compass": None, "alarm": None, "keyboard": None,
        "camera-one": None, "trumpet": None, "palm": None, "star-one": None, "telescope": None,
        "newspaper-folding": None, "ruler-one": None,
    },
}
"""Set to icon to the concept that it really shows; None if it shows none of ours, or nobody can tell."""
# fmt: on


def squeezed(name: str) -> str:
    """A name without what the sets write differently: hyphens, underscores and case."""
    return name.replace("-", "").replace("_", "").lower()


def names_of(concept: str) -> list[str]:
    """Squeezed names of a concept, its own first."""
    return list(dict.fromkeys(squeezed(name) for name in (concept, *ALSO_CALLED.get(concept, "").split())))


def logo_names_of(concept: str) -> list[str]:
    """Squeezed names of a logo, its own first."""
    return list(dict.fromkeys(squeezed(name) for name in (concept, *LOGOS_ALSO_CALLED.get(concept, "").split())))
