"""Everything that panels can show: names only, no pixels and no logic.

Animals, foods and objects are limited to drawings that exist in every style; a label pack draws them in the styles
listed here. A name is lower-case and singular, with words joined by `_`; a few are plural like their drawing.
Held-out items never occur in `open-v1:train` and appear only in `open-v1:unseen`.
"""

from __future__ import annotations

# fmt: off

ANIMALS: tuple[str, ...] = (
    "monkey", "gorilla", "orangutan", "dog", "poodle", "wolf", "fox", "raccoon", "cat", "lion", "tiger", "leopard",
    "horse", "zebra", "deer", "bison", "cow", "pig", "boar", "ram", "sheep", "goat", "camel", "llama", "giraffe",
    "elephant", "mammoth", "rhinoceros", "hippopotamus", "mouse", "rat", "hamster", "rabbit", "chipmunk", "beaver",
    "hedgehog", "bat", "bear", "polar_bear", "koala", "panda", "sloth", "otter", "skunk", "kangaroo", "badger",
    "turkey", "chicken", "rooster", "chick", "penguin", "dove", "eagle", "duck", "swan", "owl", "flamingo", "peacock",
    "parrot", "frog", "crocodile", "turtle", "lizard", "snake", "whale", "dolphin", "seal", "fish", "blowfish",
    "shark", "octopus", "crab", "lobster", "shrimp", "squid", "snail", "butterfly", "ant", "bee", "beetle", "ladybug",
    "cricket", "spider", "scorpion", "mosquito", "worm",
)

FOODS: tuple[str, ...] = (
    "apple", "green_apple", "pear", "orange", "lemon", "banana", "watermelon", "grapes", "strawberry", "blueberries",
    "melon", "cherries", "peach", "mango", "pineapple", "coconut", "kiwi", "tomato", "eggplant", "avocado",
    "broccoli", "lettuce", "cucumber", "chili_pepper", "bell_pepper", "corn", "carrot", "olive", "garlic", "onion",
    "potato", "sweet_potato", "mushroom", "peanuts", "chestnut", "croissant", "bagel", "bread", "baguette", "pretzel",
    "pancakes", "waffle", "cheese", "butter", "egg", "bacon", "steak", "chicken_leg", "burger", "fries", "pizza",
    "hot_dog", "sandwich", "taco", "burrito", "salad", "popcorn", "salt", "canned_food", "bento", "rice", "rice_ball",
    "curry", "ramen", "spaghetti", "sushi", "fried_shrimp", "dumpling", "fortune_cookie", "ice_cream", "shaved_ice",
    "donut", "cookie", "birthday_cake", "shortcake", "cupcake", "pie", "chocolate", "candy", "lollipop", "honey",
    "milk", "coffee", "tea", "wine", "cocktail", "beer", "whiskey", "champagne", "juice_box", "bubble_tea", "soda",
)
"""Foods and drinks."""

OBJECTS: tuple[str, ...] = (
    "hammer", "axe", "wrench", "screwdriver", "saw", "scissors", "key", "lock", "ladder", "magnet", "bucket", "broom",
    "basket", "soap", "sponge", "toothbrush", "razor", "mirror", "bathtub", "toilet", "bed", "couch", "chair", "door",
    "window", "light_bulb", "candle", "flashlight", "book", "newspaper", "pencil", "pen", "paintbrush", "crayon",
    "ruler", "paperclip", "envelope", "mailbox", "package", "mobile_phone", "telephone", "laptop", "keyboard",
    "computer_mouse", "printer", "television", "radio", "camera", "microphone", "headphones", "battery",
    "electric_plug", "watch", "alarm_clock", "hourglass", "floppy_disk", "abacus", "compass", "map", "globe", "car",
    "taxi", "bus", "ambulance", "fire_engine", "police_car", "truck", "tractor", "train", "bicycle", "motorcycle",
    "skateboard", "airplane", "helicopter", "rocket", "sailboat", "canoe", "parachute", "anchor", "umbrella",
    "top_hat", "crown", "sunglasses", "shirt", "jeans", "dress", "coat", "scarf", "gloves", "socks", "sneaker",
    "boot", "high_heel", "backpack", "handbag", "ring", "briefcase", "soccer_ball", "basketball", "baseball",
    "volleyball", "boxing_glove", "kite", "yo_yo", "ice_skate", "fishing_pole", "guitar", "violin", "trumpet", "drum",
    "saxophone", "accordion", "teddy_bear", "balloon", "gift", "die", "puzzle_piece", "tree", "palm_tree", "cactus",
    "sunflower", "rose", "tulip", "sun", "star", "cloud", "snowman", "fire", "rainbow", "volcano", "house", "tent",
    "castle", "pill", "syringe", "thermometer", "stethoscope", "bandage", "microscope", "telescope", "test_tube",
    "knife", "spoon", "chopsticks", "teapot", "coin", "credit_card", "trophy", "medal", "bell", "bomb", "shield",
    "bow_and_arrow", "fire_extinguisher", "shopping_cart", "traffic_light", "yarn",
)

LOGOS: tuple[str, ...] = (
    "python", "github", "firefox", "docker", "linux", "ubuntu", "debian", "rust", "javascript", "typescript", "java",
    "go", "kotlin", "swift", "ruby", "php", "react", "vue", "angular", "svelte", "django", "nodejs", "android",
    "apple", "google", "chrome", "facebook", "youtube", "instagram", "whatsapp", "telegram", "spotify", "netflix",
    "amazon", "tesla", "bmw", "audi", "toyota", "nike", "adidas", "starbucks", "mcdonalds", "visa", "mastercard",
    "paypal", "bitcoin", "ethereum", "wikipedia", "reddit", "discord", "twitch", "tiktok", "pinterest", "snapchat",
    "dropbox", "nvidia", "intel", "arduino", "raspberry_pi", "blender", "vlc", "steam", "playstation", "unity", "git",
    "gitlab", "jenkins", "kubernetes", "redis", "mysql", "postgresql", "mongodb", "wordpress", "airbnb", "uber",
    "ebay", "figma", "jupyter", "pytorch", "tensorflow", "opencv", "ros", "volkswagen", "ford", "fedora",
    "arch_linux", "opera", "signal", "bluetooth",
)
"""Brands and technologies."""

LETTERS: tuple[str, ...] = tuple("ABCDEFGHIJKLMNOPQRSTUVWXYZ")

TRAIN_FONTS: tuple[str, ...] = (
    "inter", "roboto-slab", "lora", "oswald", "playfair-display", "source-code-pro", "nunito", "bitter", "space-mono",
    "fredoka", "archivo-black", "comic-neue", "merriweather", "raleway",
)

HELD_OUT_FONTS: tuple[str, ...] = (
    "josefin-sans", "zilla-slab", "patrick-hand", "righteous",
)

TRAIN_STYLES: tuple[str, ...] = ("noto", "twemoji", "fluent")
"""Drawing styles of animals, foods and objects."""
HELD_OUT_STYLES: tuple[str, ...] = ("openmoji",)

TRAIN_PICTURE_SETS: tuple[str, ...] = (
    "noto", "noto-v1", "twemoji", "fluent", "fluent-3d", "fluent-line", "emojione", "emojione-v1", "emojione-mono",
    "game", "mdi", "tabler", "phosphor", "lucide", "arcticons",
    "color", "simple-icons", "skill-icons", "file-icons",
)
"""Sets of drawings that training may show: all sets of an artist, or none."""
CALIBRATION_PICTURE_SETS: tuple[str, ...] = ("streamline", "streamline-color", "vscode-icons")
"""Sets that no network is trained with, and by which the probabilities of trained ones are calibrated."""
HELD_OUT_PICTURE_SETS: tuple[str, ...] = (
    "openmoji", "fxemoji", "icon-park", "openclipart", "devicon", "cib", "photo",
)
"""Sets of pictures, each by others, that only tests show: two emoji sets, two-coloured line icons, the clip art of many
artists, two sets of logos, and photographs."""

LOGO_STYLE = "color"

TRAIN_PERSON_HANDS: tuple[str, ...] = ("open-peeps", "toon-head")
"""Artists of people that training may show, besides the one who draws all attributes."""
HELD_OUT_PERSON_HANDS: tuple[str, ...] = ("personas",)

TRAIN_BACKGROUNDS: tuple[str, ...] = ("sky", "sand", "mint", "rose", "lilac")
"""Colours behind a drawn person."""
HELD_OUT_BACKGROUNDS: tuple[str, ...] = ("slate", "cream")

LOOKALIKES: tuple[frozenset[str], ...] = (
    frozenset({"monkey", "gorilla", "orangutan"}),
    frozenset({"dog", "poodle", "wolf", "fox"}),
    frozenset({"cat", "lion", "tiger", "leopard"}),
    frozenset({"horse", "zebra", "deer"}),
    frozenset({"bison", "cow", "boar", "pig"}),
    frozenset({"ram", "sheep", "goat"}),
    frozenset({"camel", "llama"}),
    frozenset({"elephant", "mammoth"}),
    frozenset({"mouse", "rat", "hamster", "chipmunk", "beaver"}),
    frozenset({"raccoon", "badger", "skunk"}),
    frozenset({"bear", "polar_bear", "panda", "koala"}),
    frozenset({"chicken", "rooster", "chick", "turkey"}),
    frozenset({"dove", "eagle", "duck", "swan", "parrot"}),
    frozenset({"whale", "dolphin", "seal", "otter"}),
    frozenset({"fish", "blowfish", "shark", "dolphin", "whale"}),
    frozenset({"lobster", "shrimp", "crab"}),
    frozenset({"squid", "octopus"}),
    frozenset({"ant", "bee", "beetle", "ladybug", "cricket", "mosquito", "spider"}),
    frozenset({"snake", "worm", "lizard", "crocodile"}),
)
"""Animals that share a name or are easily confused: never options of one task."""
# fmt: on
