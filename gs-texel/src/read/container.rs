//! The GLB container of a glTF file, and its JSON, whose size is bounded before it is parsed.

use super::buffers::Folder;
use super::error::CharacterError;
use gltf::json::Root;

/// Maximum number of objects in the JSON: a character of 100 joints and 100 clips has about 100 000.
const MAX_OBJECTS: usize = 400_000;
/// Maximum number of values in the JSON.
const MAX_VALUES: usize = 3_000_000;

fn syntax(file: &str, what: impl Into<String>) -> CharacterError {
    CharacterError::Syntax { file: file.into(), what: what.into() }
}

/// Splits a file into JSON and binary chunk.
pub(super) fn split<'a>(bytes: &'a [u8], file: &str) -> Result<(&'a [u8], Option<&'a [u8]>), CharacterError> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |at: usize| bytes.get(at..at + 4).and_then(|b| b.first_chunk()).map(|b| u32::from_le_bytes(*b));
    let version = word(4).ok_or_else(|| syntax(file, "GLB header cut short at byte 4"))?;
    if version != 2 {
        return Err(syntax(file, format!("GLB version {version}, not 2 (byte 4)")));
    }
    if word(8).map(|n| n as usize) != Some(bytes.len()) {
        let stated = word(8).unwrap_or(0);
        return Err(syntax(file, format!("GLB of {stated} bytes by its header (byte 8), {} are there", bytes.len())));
    }
    let (mut at, mut chunks) = (12usize, [None, None]);
    while at < bytes.len() {
        let length = word(at).map(|n| n as usize);
        let body = length.and_then(|n| bytes.get(at + 8..(at + 8).checked_add(n)?));
        let body = body.ok_or_else(|| syntax(file, format!("GLB chunk at byte {at} reaches beyond the file")))?;
        match (bytes.get(at + 4..at + 8), &mut chunks) {
            (Some(b"JSON"), [slot @ None, None]) | (Some(b"BIN\0"), [Some(_), slot @ None]) => *slot = Some(body),
            (_, [Some(_), _]) => {} // Chunks of extensions are ignored.
            _ => return Err(syntax(file, "the first chunk of the GLB is no JSON (byte 16)")),
        }
        at += 8 + body.len();
    }
    let [json, binary] = chunks;
    Ok((json.ok_or_else(|| syntax(file, "GLB without a JSON chunk (byte 12)"))?, binary))
}

/// Parses the JSON after counting its objects and values.
pub(super) fn parse(json: &[u8], file: &str) -> Result<Root, CharacterError> {
    let (mut in_string, mut escaped, mut objects, mut values) = (false, false, 0usize, 0usize);
    for &b in json {
        match (in_string, b) {
            (true, _) if escaped => escaped = false,
            (true, b'\\') => escaped = true,
            (_, b'"') => in_string = !in_string,
            (false, b'{') => (objects, values) = (objects + 1, values + 1),
            (false, b',' | b'[') => values += 1,
            _ => {}
        }
    }
    if objects > MAX_OBJECTS || values > MAX_VALUES {
        let what = format!("JSON of {objects} objects and {values} values");
        return Err(CharacterError::TooMuch { file: file.into(), what });
    }
    Root::from_slice(json).map_err(|e| {
        let mut what = format!("no glTF 2.0: {e}");
        what.truncate(what.char_indices().nth(300).map_or(what.len(), |(at, _)| at));
        syntax(file, what)
    })
}

/// The bytes of every buffer, at least as many as declared.
pub(super) fn buffers(root: &Root, binary: Option<&[u8]>, folder: &Folder<'_>) -> Result<Vec<Vec<u8>>, CharacterError> {
    let mut out = Vec::with_capacity(root.buffers.len());
    let mut total = 0u64;
    for (i, buffer) in root.buffers.iter().enumerate() {
        let malformed =
            |what: String| CharacterError::Malformed { file: folder.file.into(), place: format!("buffer {i}"), what };
        let bytes = match (&buffer.uri, binary) {
            (Some(uri), _) => folder.read(uri)?,
            (None, Some(bytes)) if i == 0 => bytes.to_vec(),
            _ => return Err(malformed("has neither a URI nor a binary chunk".into())),
        };
        let (need, have) = (buffer.byte_length.0, bytes.len() as u64);
        if need > have {
            return Err(malformed(format!("needs {need} bytes, {have} are there")));
        }
        total += have;
        if total > folder.limits.max_bytes {
            return Err(CharacterError::TooMuch { file: folder.file.into(), what: "the sum of the buffers".into() });
        }
        out.push(bytes);
    }
    Ok(out)
}

/// Whether an extension is read, or concerns only parts that are not read.
fn is_supported(name: &str) -> bool {
    let plain = ["KHR_texture_transform", "KHR_mesh_quantization", "KHR_lights_punctual", "KHR_node_visibility"];
    plain.contains(&name) || name.starts_with("KHR_materials_")
}

/// Refuses files that require an extension that is not supported.
pub(super) fn extensions(root: &Root, file: &str) -> Result<(), CharacterError> {
    match root.extensions_required.iter().find(|e| !is_supported(e)) {
        None => Ok(()),
        Some(name) => Err(CharacterError::Unsupported {
            file: file.into(),
            what: format!("the extension {name}"),
            advice: "export without compression (Draco, meshopt) and with PNG or JPEG textures",
        }),
    }
}
