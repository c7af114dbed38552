//! The class table of the Replica dataset (its `info_semantic.json`): ids 1 to 101, 0 is undefined.

use crate::data::Classes;

/// In the order of their ids, from 1.
const NAMES: &str = "backpack base-cabinet basket bathtub beam beanbag bed bench bike bin blanket blinds book bottle box bowl \
    camera cabinet candle chair chopping-board clock cloth clothing coaster comforter computer-keyboard cup cushion curtain \
    ceiling cooktop countertop desk desk-organizer desktop-computer door exercise-ball faucet floor handbag hair-dryer handrail \
    indoor-plant knife-block kitchen-utensil lamp laptop major-appliance mat microwave monitor mouse nightstand pan panel \
    paper-towel phone picture pillar pillow pipe plant-stand plate pot rack refrigerator remote-control scarf sculpture shelf \
    shoe shower-stall sink small-appliance sofa stair stool switch table table-runner tablet tissue-paper toilet toothbrush \
    towel tv-screen tv-stand umbrella utensil-holder vase vent wall wall-cabinet wall-plug wardrobe window rug logo bag \
    set-of-clothing";

/// All 101 classes.
pub(crate) fn replica() -> Classes {
    Classes::from_names(0, (1..).zip(NAMES.split_ascii_whitespace()))
}
