//! Writes what `torch.save` writes: a stored zip of a pickle and one file of bytes a tensor.

use std::collections::BTreeMap;

/// Values of a nested dictionary.
pub enum Value {
    Dict(Vec<(String, Value)>),
    Tensor(Vec<usize>, Vec<f32>),
    Int(i32),
    /// An `argparse.Namespace`, which training scripts save their arguments as.
    Namespace(Vec<(String, Value)>),
}

/// The tensors as a dictionary in the file's order.
pub fn state_dict(tensors: &BTreeMap<String, (Vec<usize>, Vec<f32>)>, prefix: &str) -> Value {
    let tensors = tensors.iter();
    Value::Dict(
        tensors
            .map(|(k, (s, v))| (format!("{prefix}{k}"), Value::Tensor(s.clone(), v.clone())))
            .collect(),
    )
}

pub fn bytes(root: &Value) -> Vec<u8> {
    zip(&entries(root))
}

/// Names and contents of the files in the archive; the first one is the pickle.
pub fn entries(root: &Value) -> Vec<(String, Vec<u8>)> {
    let mut pickle = Pickle {
        code: vec![0x80, 2],
        storages: vec![],
    };
    pickle.value(root);
    pickle.code.push(b'.');
    let mut entries = vec![("archive/data.pkl".to_owned(), pickle.code)];
    let storages = pickle.storages.into_iter().enumerate();
    entries.extend(storages.map(|(n, bytes)| (format!("archive/data/{n}"), bytes)));
    entries.push(("archive/version".to_owned(), b"3\n".to_vec()));
    entries
}

struct Pickle {
    code: Vec<u8>,
    storages: Vec<Vec<u8>>,
}

impl Pickle {
    fn value(&mut self, value: &Value) {
        match value {
            Value::Int(n) => self.int(*n),
            Value::Dict(entries) => self.dict(entries),
            Value::Namespace(entries) => {
                self.code.extend(b"cargparse\nNamespace\n)\x81");
                self.dict(entries);
                self.code.push(b'b');
            }
            Value::Tensor(shape, values) => {
                self.code.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
                self.text("storage");
                self.code.extend(b"ctorch\nFloatStorage\n");
                self.text(&self.storages.len().to_string());
                self.text("cpu");
                self.int(values.len() as i32);
                self.code.extend(b"tQ");
                self.int(0);
                self.code.push(b'(');
                shape.iter().for_each(|&n| self.int(n as i32));
                self.code.extend(b"t(");
                (1..=shape.len())
                    .for_each(|k| self.int(shape[k..].iter().product::<usize>() as i32));
                self.code.extend(b"t\x89ccollections\nOrderedDict\n)RtR");
                self.storages
                    .push(values.iter().flat_map(|v| v.to_le_bytes()).collect());
            }
        }
    }

    fn dict(&mut self, entries: &[(String, Value)]) {
        self.code.extend(b"}(");
        for (key, value) in entries {
            self.text(key);
            self.value(value);
        }
        self.code.push(b'u');
    }

    fn text(&mut self, text: &str) {
        self.code.push(b'X');
        self.code.extend((text.len() as u32).to_le_bytes());
        self.code.extend(text.as_bytes());
    }

    fn int(&mut self, n: i32) {
        self.code.push(b'J');
        self.code.extend(n.to_le_bytes());
    }
}

/// A zip archive without compression.
pub fn zip(entries: &[(String, Vec<u8>)]) -> Vec<u8> {
    let (mut file, mut directory) = (Vec::new(), Vec::new());
    for (name, bytes) in entries {
        // Version, flags, method, time, date; checksum, both sizes; lengths of the name and of nothing more.
        let mut shared: Vec<u8> = [20_u16, 0, 0, 0, 33]
            .iter()
            .flat_map(|x| x.to_le_bytes())
            .collect();
        shared.extend(crc32(bytes).to_le_bytes());
        shared.extend([bytes.len() as u32; 2].iter().flat_map(|x| x.to_le_bytes()));
        shared.extend([name.len() as u16, 0].iter().flat_map(|x| x.to_le_bytes()));
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&shared);
        directory.extend([0; 10]);
        directory.extend((file.len() as u32).to_le_bytes());
        directory.extend(name.as_bytes());
        file.extend(b"PK\x03\x04");
        file.extend(&shared);
        file.extend(name.as_bytes());
        file.extend(bytes);
    }
    let start = file.len() as u32;
    file.extend(&directory);
    file.extend(b"PK\x05\x06\0\0\0\0");
    file.extend(
        [entries.len() as u16; 2]
            .iter()
            .flat_map(|x| x.to_le_bytes()),
    );
    file.extend((directory.len() as u32).to_le_bytes());
    file.extend(start.to_le_bytes());
    file.extend([0; 2]);
    file
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0_u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| {
            if c & 1 == 1 {
                c >> 1 ^ 0xedb8_8320
            } else {
                c >> 1
            }
        })
    })
}
