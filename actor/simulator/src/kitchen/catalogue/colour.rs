//! Colours that many categories share, 8-bit sRGB.

pub const STEEL: [u8; 3] = [186, 190, 195];
pub const IRON: [u8; 3] = [58, 58, 62];
pub const COPPER: [u8; 3] = [184, 115, 72];
pub const GLASS: [u8; 3] = [190, 215, 215];
pub const GREEN_GLASS: [u8; 3] = [52, 86, 58];
pub const AMBER_GLASS: [u8; 3] = [122, 76, 36];
pub const WHITE: [u8; 3] = [238, 236, 230];
pub const CREAM: [u8; 3] = [232, 220, 192];
pub const BLACK: [u8; 3] = [40, 40, 44];
pub const GREY: [u8; 3] = [128, 130, 134];
pub const WOOD: [u8; 3] = [176, 130, 84];
pub const DARK_WOOD: [u8; 3] = [112, 74, 46];
pub const WICKER: [u8; 3] = [190, 154, 102];
pub const RED: [u8; 3] = [190, 52, 46];
pub const ORANGE: [u8; 3] = [232, 138, 44];
pub const YELLOW: [u8; 3] = [236, 202, 68];
pub const GREEN: [u8; 3] = [96, 150, 66];
pub const DARK_GREEN: [u8; 3] = [52, 98, 50];
pub const BLUE: [u8; 3] = [70, 112, 172];
pub const PURPLE: [u8; 3] = [88, 52, 88];
pub const BROWN: [u8; 3] = [136, 90, 52];
pub const KRAFT: [u8; 3] = [188, 152, 108];
pub const TERRACOTTA: [u8; 3] = [188, 98, 66];
pub const PINK: [u8; 3] = [222, 150, 150];
