//! The lanes of the depth camera, and the words that processes share, each as it stands in the product.

#[path = "../../../proto/wire/src/shm.rs"]
pub mod shm;
#[path = "../../../actor/depth/src/simd.rs"]
pub mod simd;

/// Miri knows no mapped files.
#[cfg(all(test, not(miri)))]
mod tests {
    use super::shm::SharedWords;

    #[test]
    fn halves_of_words_are_counted_by_several_threads_and_touch_no_other_word() {
        use std::sync::atomic::Ordering;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("halves");
        SharedWords::create(&path, 3).unwrap();
        let words = SharedWords::open(&path, 3, true).unwrap();
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..10_000).for_each(|_| drop(words.low(1).fetch_add(1, Ordering::SeqCst))));
            }
        });
        assert_eq!([0, 1, 2].map(|index| words.load(index)), [0, 40_000, 0]);
    }

    #[test]
    fn words_are_read_and_written_by_several_threads_to_the_last_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("words");
        SharedWords::create(&path, 600).unwrap();
        assert!(SharedWords::open(&path, 601, false).is_err());
        // As processes, each has a mapping of its own.
        let open = |writable| SharedWords::open(&path, 600, writable).unwrap();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let words = open(true);
                (1..=1000).for_each(|value| (0..600).for_each(|index| words.store(index, value)));
            });
            scope.spawn(|| {
                let words = open(false);
                let began = std::time::Instant::now();
                while words.load(599) < 1000 {
                    assert!(began.elapsed().as_secs() < 60, "the writer has ended");
                }
            });
        });
        let reader = open(false);
        assert!((0..600).all(|index| reader.load(index) == 1000));
    }
}
