//! Files of SPZ version 4.

use ruzstd::encoding::{CompressionLevel, compress_to_vec};

/// The file of version 4 with the unpacked content of one of version 3, whose SH degree is 1.
pub fn version_4(content: &[u8]) -> Vec<u8> {
    let (header, mut rest) = content.split_at(16);
    let count = u32::from_le_bytes([header[8], header[9], header[10], header[11]]) as usize;
    let (mut table, mut streams) = (Vec::new(), Vec::new());
    for width in [9, 1, 3, 3, 4, 9] {
        let (array, behind) = rest.split_at(width * count);
        rest = behind;
        let packed = compress_to_vec(array, CompressionLevel::Fastest);
        table.extend((packed.len() as u64).to_le_bytes());
        table.extend((array.len() as u64).to_le_bytes());
        streams.extend(packed);
    }
    let mut header = header.to_vec();
    header[4] = 4;
    header[15] = 6;
    // Where the table is, and what is reserved.
    header.extend([32, 0, 0, 0]);
    header.extend([0; 12]);
    [header, table, streams].concat()
}
