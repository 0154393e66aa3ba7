//! Which views of nerfstudio's layout train.

use crate::layouts::{Folder, number};
use gs_data::DataOptions;
use serde_json::json;

#[test]
fn nerfstudio_frames_that_are_held_out_never_train() {
    type Lists<'a> = &'a [(&'a str, &'a [usize])];
    let f = Folder::new(5, "png");
    let open = |lists: Lists| {
        let mut j = f.nerfstudio();
        for (key, frames) in lists {
            let names: Vec<String> = frames.iter().map(|k| format!("images/f{k:03}.png")).collect();
            j[format!("{key}_filenames")] = json!(names);
        }
        f.put("transforms.json", j.to_string());
        f.open(&DataOptions::default())
    };
    let splits = |lists: Lists| {
        let d = open(lists).unwrap();
        [d.train, d.val, d.test].map(|views| views.iter().map(|v| number(&v.name)).collect::<Vec<_>>())
    };
    assert_eq!(splits(&[("test", &[1, 3])]), [vec![0, 2, 4], vec![], vec![1, 3]]);
    assert_eq!(splits(&[("val", &[0])]), [vec![1, 2, 3, 4], vec![0], vec![]]);
    assert_eq!(
        splits(&[("val", &[0, 1]), ("test", &[1])]),
        [vec![2, 3, 4], vec![0], vec![1]],
        "a test view is no other"
    );
    assert_eq!(splits(&[("train", &[0, 2])]), [vec![0, 2], vec![], vec![]]);
    assert_eq!(splits(&[("val", &[]), ("test", &[])]), [vec![1, 2, 3, 4], vec![], vec![0]], "every eighth");
    let notes = open(&[("test", &[1])]).unwrap().notes.concat();
    assert!(notes.contains("the 4 frames that are not held out train"), "{notes}");
    let faults: [(Lists, &str); 3] = [
        (&[("train", &[0, 1]), ("test", &[3, 1])], "images/f001.png\", which train_filenames lists too"),
        (&[("train", &[0]), ("val", &[2, 0])], "images/f000.png\", which train_filenames lists too"),
        (&[("test", &[3, 9])], "images/f009.png\", which is the file_path of no frame"),
    ];
    for (lists, want) in faults {
        let e = open(lists).unwrap_err();
        assert!(e.code() == "data.field" && e.to_string().contains("_filenames[1] is "), "{e}");
        assert!(e.to_string().contains(want), "{e}");
    }
}
