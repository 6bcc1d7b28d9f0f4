"""The files of the Open Clip Art Library that show our concepts: found by name, then looked at."""

# fmt: off
FILES: dict[str, str] = {
    "monkey":
        "animals/mammals/monkey_head_nicu_buculei_01 "
        "animals/mammals/angry_monkey_benji_park_01 "
        "animals/mammals/happy_monkey_benji_park_01 "
        "animals/sailor_monkey_nicu_bucul_01",
    "orangutan": "animals/mammals/contour_orangutan",
    "dog":
        "animals/mammals/dogs/dog_head_nicu_buculei_01 "
        "animals/mammals/dogs/dog_head_nicu_buculei_02 "
        "animals/mammals/dog_01_drawn_with_strai_01 "
        "animals/mammals/dog_03_drawn_with_strai_01",
    "wolf": "animals/mammals/stylized_wolf_head_geral_01 animals/mammals/simple_stylized_wolf_he_01",
    "fox": "animals/mammals/contour_fox",
    "raccoon": "animals/mammals/raccoon_ganson",
    "cat":
        "animals/mammals/cartoon_cat_gerald_g._01 "
        "animals/mammals/housecats/gattina_cat_architetto_f_01 "
        "animals/mammals/housecats/gatto_cat_architetto_fra_01 "
        "animals/mammals/housecats/gatto_cat_architetto_fra_03",
    "tiger":
        "animals/mammals/big_cats/tiger_graig_ryan_smith_-_01 "
        "animals/mammals/big_cats/color_tiger_susan_park_01 "
        "animals/mammals/big_cats/b_w_tiger_susan_park_01",
    "deer": "animals/mammals/deer_matt_todd_01",
    "bison": "animals/bison_leif_lodahl_01",
    "pig": "animals/mammals/pig_marcelo_caiafa1 animals/mammals/a_simple_pig_01",
    "ram": "animals/mammals/dall_sheep_ram_ganson",
    "sheep": "animals/mammals/sheep-md-v0.1",
    "goat": "animals/mammals/goat_nicu_buculei_01",
    "camel": "animals/mammals/camel_head_01 animals/mammals/contour_camel",
    "giraffe": "animals/mammals/contour_giraffe",
    "elephant": "animals/mammals/elephant_symbol_ganson animals/mammals/contour_elephant animals/mammals/elephant_01",
    "rhinoceros": "animals/mammals/rhinoceros_3d_architetto_01 animals/mammals/rhinoceros_architetto_fr_01",
    "computer_mouse":
        "computer/hardware/mouse "
        "computer/hardware/mouse2 "
        "signs_and_symbols/mouse1 "
        "computer/mouse_the_structorr_",
    "rabbit": "animals/mammals/bunny_01",
    "chipmunk": "animals/mammals/contour_chipmunk",
    "beaver": "animals/mammals/contour_beaver",
    "bat": "animals/bat_orlando_karam_ animals/birds/contour_bat",
    "bear": "animals/mammals/bears/bear_peterm_01",
    "kangaroo": "animals/mammals/contour_kangaroo",
    "chicken": "animals/birds/hen_01",
    "rooster": "animals/birds/rooster_01",
    "penguin": "animals/birds/emperor_penguin_ralf_ste_01 animals/birds/new_penguin_charles_mcco_01",
    "dove": "animals/birds/dove_symbol",
    "eagle": "animals/birds/eagle_01",
    "duck": "animals/birds/duck_yellow_kurt_cagle_ recreation/toys/rubber_duck1_ganson",
    "owl": "animals/birds/owl_on_branch_ganson",
    "frog": "animals/red-eye_frog_mirko_maisc_01",
    "turtle": "animals/turtle_jurgen_gaeremyn_01",
    "lizard": "animals/lizard_guillaume_boitel_ animals/az-lizard_benji_park_01",
    "whale": "animals/fish/bluewhale-md",
    "dolphin": "animals/fish/dolphin animals/fish/dolphin_enrique_meza_c_01 animals/fish/dolphin_enrique_meza_c_02",
    "seal": "animals/mammals/seal",
    "fish": "animals/fish/brown_fish_01 animals/fish/giraffe_cichlid_01",
    "lobster": "animals/crawfish1_ganson animals/crawfish1_bw_ganson",
    "butterfly":
        "animals/bugs/butterfly_jonvdveen_01 "
        "animals/bugs/butterfly_jonathan_dietr_01 "
        "animals/bugs/farfalla_butterfly_fra1",
    "ant": "animals/bugs/ant",
    "bee": "animals/bugs/bee animals/bugs/bee1_mimooh_01 animals/bugs/bee3_mimooh_01",
    "ladybug": "animals/bugs/ladybug_01 animals/bugs/ladybug_02",
    "spider": "animals/bugs/spider",
    "scorpion": "animals/scorpion-md-v0.1",
    "apple": "food/fruit/apple food/fruit/apple_bw",
    "pear": "food/fruit/pear food/fruit/pear_01 food/fruit/pear_simple food/fruit/pear_simple_bw",
    "orange": "food/fruit/orange food/fruit/orange_simple food/fruit/orange_simple_bw",
    "lemon": "food/fruit/lemon food/fruit/lemon1 food/fruit/lemon_simple food/fruit/lemon_half_ganson",
    "banana": "food/fruit/banana food/fruit/bananas_nicu_buculei_01",
    "watermelon":
        "food/fruit/watermelon_simple "
        "food/fruit/watermelon_simple_bw "
        "food/fruit/watermelon_james_kilfige_01",
    "grapes": "food/fruit/grape_01 food/fruit/grapes_01 food/fruit/grapes_simple food/fruit/grapes_leif_lodahl_02",
    "strawberry":
        "food/fruit/strawberry "
        "food/fruit/strawberry_01 "
        "food/fruit/strawberry_simple "
        "food/fruit/strawberry_jonathan_diet_01",
    "melon": "food/fruit/melon_goneri_le_bouder_01",
    "cherries": "food/fruit/cherries food/fruit/cherry_jean_victor_balin_",
    "pineapple": "food/fruit/pineapple",
    "chili_pepper": "food/vegetables/peperoncino_pepper_fra_ food/vegetables/cayenne_pepper_1_simple_01",
    "corn": "food/vegetables/corn_cob food/vegetables/corn_cob_bw",
    "onion": "food/vegetables/onion_joerg_rosenbauer_01",
    "potato": "food/breads_and_carbs/potato_nicu_buculei_",
    "mushroom": "plants/mushroom plants/mushroom_benji_park_ plants/toadstool_daniel_steele_r",
    "croissant": "food/breads_and_carbs/croissant_01 food/breads_and_carbs/croissant_gerald_g._01",
    "bread": "food/breads_and_carbs/bread food/breads_and_carbs/bread_01",
    "pretzel": "food/breads_and_carbs/pretzel_01",
    "pancakes": "food/breads_and_carbs/pancake food/breads_and_carbs/pancakes_berries",
    "cheese": "food/dairy/cheese_01",
    "butter": "food/dairy/butter_01",
    "egg": "food/meats_and_eggs/fried_egg food/meats_and_eggs/half_egg_jean-victor_bal_01",
    "bacon": "food/meats_and_eggs/bacon_ganson",
    "steak": "food/meats_and_eggs/steak-v0.1",
    "burger":
        "food/meats_and_eggs/hamburger_ganson "
        "food/meats_and_eggs/hamburger_bw "
        "food/meats_and_eggs/burger_http_www.treebuil_ "
        "food/meats_and_eggs/burger_http_www.treebui_r",
    "fries": "food/fries_ganson food/fries_bw food/french_fries_juliane_kr_r",
    "pizza": "food/pizza_cheese food/pizza_pepperoni food/pizza_slice_01 food/pizza_4_stagioni_archite_01",
    "hot_dog":
        "food/meats_and_eggs/hot_dog "
        "food/meats_and_eggs/hot_dog_bw "
        "food/meats_and_eggs/hot_dog_juliane_krug_r",
    "sandwich": "food/sandwich_one_jean-victor_01 food/submarine_sandwich_01",
    "burrito": "food/burrito_ganson",
    "spaghetti": "food/spaghetti_ganson food/spaghetti_bw",
    "ice_cream": "food/desserts/cone_soft_chocolate",
    "birthday_cake": "food/desserts/birthday_cake food/desserts/cake_etienne_bersac_r",
    "cupcake": "food/breads_and_carbs/muffin1 food/breads_and_carbs/muffin2 food/desserts/muffin_jean_victor_balin_",
    "pie": "food/desserts/pie_cherry food/desserts/pie_pumpkin food/desserts/pie_apple",
    "candy": "food/desserts/candy_01 food/desserts/candy_02",
    "lollipop": "food/desserts/candy_20 food/desserts/candy_30 food/desserts/lollipop_dave_pena_01",
    "milk": "food/beverages/milk_ganson food/beverages/milk_bw food/beverages/milk_carton_jarno_vasama_",
    "coffee":
        "food/beverages/coffee "
        "food/beverages/coffee_ganson "
        "signs_and_symbols/map_symbols/coffee_jean_victor_balin_",
    "tea": "food/beverages/teacup_ganson food/beverages/teacup_bw food/beverages/coffe_tea_01",
    "wine": "food/beverages/alcohol/wine food/beverages/alcohol/wine_glass_christian_h._",
    "cocktail": "food/beverages/alcohol/cocktail_daniel_steele_r food/beverages/alcohol/martini_glass_k_yager_01",
    "beer": "food/beverages/alcohol/beer food/beverages/alcohol/beer1",
    "juice_box": "food/beverages/apple_juice_box food/beverages/orange_juice_box food/beverages/apple_juice_box_bw",
    "soda": "food/beverages/soft_drink food/beverages/soft_drink_bw",
    "hammer": "tools/hammer_peterm1 tools/hammer_nicu_buculei_01 tools/construction_hammer_jon__01",
    "axe": "tools/axe_peterm_",
    "screwdriver": "tools/screwdriver_peterm_",
    "saw": "tools/saw_peterm_",
    "scissors": "education/scissors education/scissors_02",
    "key": "tools/key_jordan_wiens_01",
    "lock": "tools/lock signs_and_symbols/padlock_aj_ashton_01",
    "broom": "tools/broom_nicu_buculei_01",
    "toothbrush": "tools/toothbrush_and_paste_ganson",
    "light_bulb":
        "electronics/bulb/bulb "
        "electronics/bulb/lightbulb_brightlit_benj_ "
        "electronics/bulb/lightbulb_jon_phillips_01 "
        "electronics/bulb/lightbulb_lit_benji_park_",
    "book":
        "education/books/book_01 "
        "education/books/book_02 "
        "education/books/books-aj.svg_aj_ashton_01 "
        "education/books/closed_book_01",
    "newspaper": "education/books/newspaper_nicu_buculei_01",
    "pencil": "education/pencil_benji_park_01 office/pencil_jonathan_dietrich_01",
    "pen": "education/pen_01 education/pen_uliphant_01 office/ballpoint_pen_jonathan_d_01",
    "paintbrush": "tools/paint_brush_costea_bogda_01 education/brush",
    "crayon": "education/crayon",
    "paperclip": "education/paperclip",
    "envelope": "office/envelope_01 office/envelope_juliane_krug_01",
    "mailbox": "office/mailbox1 office/mailbox2",
    "package": "containers/cardboard_box_jarno_vasa_",
    "mobile_phone": "office/telephone/mobile office/telephone/mobile_phone_01",
    "telephone": "office/telephone/telephone_receiver_01 signs_and_symbols/map_symbols/aiga_telephone1",
    "laptop": "computer/hardware/laptop computer/hardware/laptop_01 computer/etiquette_laptop_01",
    "keyboard": "computer/hardware/keyboard_01 computer/hardware/keyboard",
    "printer":
        "computer/hardware/printer "
        "office/printer1 "
        "computer/hardware/printer_anton_yu_01 "
        "computer/hardware/printer_nicu_buculei_01",
    "television": "buildings/furniture/television_peterm_ recreation/tv_01 electronics/television_alexander_d.__01",
    "camera":
        "computer/hardware/digital-camera_aj_ashton_01 "
        "electronics/camera_michael_tunniclif_01 "
        "electronics/camera_icon_stuart_moore_01 "
        "computer/hardware/digital_camera_nicu_bucu_01",
    "microphone": "recreation/music/microphone_stand_gerald__01",
    "headphones": "recreation/music/headphones_davide_pesent_",
    "battery":
        "electronics/battery/battery_01 "
        "electronics/battery/battery_snuatautisticido_01 "
        "electronics/battery/battery_jean-victor_bali_01",
    "alarm_clock":
        "signs_and_symbols/clocks/alarm_clock_mike_powers_ "
        "signs_and_symbols/clocks/alarm_clock_gerald_g._01",
    "hourglass": "signs_and_symbols/clocks/sandglass_vermin_",
    "floppy_disk": "computer/floppy computer/floppy_frederic_moser_01 computer/floppy_disk_architetto_f_01",
    "globe":
        "geography/globe_marcelo_staudt_ "
        "geography/globe_01 "
        "geography/svg_globe "
        "geography/pseudo_globe_twilight_",
    "car": "transportation/vehicles/car transportation/car_jamin_ellis_",
    "taxi": "signs_and_symbols/map_symbols/aiga_taxi_ signs_and_symbols/map_symbols/aiga_taxi1",
    "bus": "transportation/bus1_jarno_vasamaa_01 transportation/bus2_jarno_vasamaa_01",
    "truck":
        "transportation/truck_jarno_vasamaa1 "
        "transportation/truck_jarno_vasamaa_ "
        "transportation/small_truck_steffen_gluc_01 "
        "transportation/old_truck_indana_model__01",
    "train": "recreation/toys/kiddy_train_orlando_kara_",
    "bicycle": "transportation/vehicles/bicycle_01 transportation/bike_tobias_jakobs_",
    "motorcycle": "transportation/motorcycle_jarno_vasama_",
    "airplane": "transportation/vehicles/plane_silhouet_mo_01 transportation/vehicles/airplane_nicu_buculei_01",
    "rocket": "transportation/vehicles/rocket",
    "sailboat":
        "transportation/boating/sailboat_illustration "
        "transportation/boating/boat_jarno_vasamaa1 "
        "transportation/boating/boat_jarno_vasamaa_",
    "anchor": "transportation/anchor transportation/anchor_juliane_krug_01",
    "umbrella": "tools/umbrella geography/canada_umbrella_ganson",
    "top_hat": "recreation/party/tophat_benji_park_01",
    "boot": "recreation/holiday/hiking_boot_jarno_vasama_",
    "soccer_ball": "recreation/sports/soccer_ball_ganson recreation/sports/soccer_ballon_tanguy_jac_",
    "baseball": "recreation/sports/baseball_bw_ganson recreation/sports/baseball_anthony_liekens_01",
    "guitar":
        "recreation/music/guitar_jarno_vasamaa1 "
        "recreation/music/guitar_ganson "
        "recreation/music/guitar_jarno_vasamaa2 "
        "recreation/music/guitar_profile_philippe__01",
    "violin": "recreation/music/violin_colour_ganson recreation/music/violin_ganson",
    "trumpet": "recreation/music/trumpet_b_flat_colour_ganso",
    "saxophone": "recreation/music/saxophone_jarno_vasamaa_",
    "teddy_bear":
        "recreation/toys/simple_teddy_bear_gerald_01 "
        "recreation/toys/teddybear_jarno_vasamaa_ "
        "recreation/toys/stylized_teddy_bear_gera_01",
    "balloon":
        "recreation/party/balloon-blue-aj "
        "recreation/party/balloons-aj "
        "recreation/party/balloon-black-aj "
        "recreation/party/balloon-red-aj",
    "gift": "recreation/holiday/gift01 recreation/holiday/gift02 recreation/holiday/gift05",
    "die": "recreation/dice recreation/games/two_red_dice_01",
    "tree": "food/fruit/tree_whit_fruits_01 plants/tree_branches_and_roots_01",
    "palm_tree": "plants/palmtree_b_r_kessels_ plants/island_palm_and_the_sun_01",
    "cactus": "plants/cactus_linda_kim_01",
    "rose": "unsorted/rose",
    "tulip": "plants/flowers/tulips_ganson",
    "sun":
        "signs_and_symbols/weather/sun01 "
        "signs_and_symbols/weather/sun_ff77_01 "
        "signs_and_symbols/weather/sun_tatiana_coutinho_01",
    "sunflower": "plants/flowers/sun_flower_ganson",
    "cloud": "signs_and_symbols/cloud_jon_phillips_01",
    "snowman": "recreation/holiday/snowman_01",
    "fire": "recreation/party/fire_valessio_soares_de_ signs_and_symbols/flame_jon_phillips_01",
    "fire_extinguisher":
        "signs_and_symbols/map_symbols/aiga_fire_extinguisher_ "
        "signs_and_symbols/map_symbols/aiga_fire_extinguisher1",
    "rainbow": "signs_and_symbols/led/leds_and_rainbow",
    "house": "buildings/homes/home0 buildings/homes/home1 buildings/homes/home14",
    "castle": "signs_and_symbols/map_symbols/castle_-_rpg_map_elemen_01 recreation/sand_castle_nathan_hawke_01",
    "telescope": "tools/telescope_01 geography/spyglass_vladimir_hernan_01",
    "knife": "tools/weapons/knife",
    "teapot": "food/beverages/teapot_ganson",
    "coin": "signs_and_symbols/money/gold_coins_in_a_stack_jo_01",
    "trophy": "signs_and_symbols/awards/trophy",
    "bomb": "tools/weapons/bomb_01",
    "shield": "tools/weapons/shield_matt_todd_01 tools/weapons/shield_matt_todd_02",
    "traffic_light": "signs_and_symbols/traffic_light_dan_gerhar_01 signs_and_symbols/traffic_light_red_dan_ge_01",
}
"""Concept to files, without their suffix."""
# fmt: on
