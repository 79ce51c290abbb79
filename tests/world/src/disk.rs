//! A file system that forgets. A process that is killed loses nothing that it wrote; when the power fails, what was not
//! synchronised is kept, torn or dropped as the dice say, each name and each file by itself.

use crate::dice::Dice;
use proto::disk::Disk;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{Error, ErrorKind, Result};
use std::path::{Path, PathBuf};
use std::rc::Rc;

#[derive(Debug, Default, Clone)]
struct File {
    content: Vec<u8>,
    /// This much of it is on the disk for good.
    synced: usize,
}

#[derive(Debug, Default)]
#[expect(clippy::struct_excessive_bools, reason = "each is a fault of its own")]
struct State {
    files: Vec<File>,
    names: BTreeMap<PathBuf, usize>,
    /// The names as they are on the disk for good.
    durable: BTreeMap<PathBuf, usize>,
    /// Changes of names that are not, in their order: a file's number, or none where it was removed.
    pending: Vec<(PathBuf, Option<usize>)>,
    full: bool,
    /// Content, or names, are never synchronised: mutations that a power failure must find.
    forgets_files: bool,
    forgets_names: bool,
    /// Operations until the process that works here is killed.
    crash_in: Option<u32>,
    crashed: bool,
}

#[derive(Debug, Default, Clone)]
pub struct SimulatedDisk(Rc<RefCell<State>>);

impl SimulatedDisk {
    /// From now on it synchronises nothing of files, or of names.
    pub fn forget(&self, files: bool, names: bool) {
        let mut state = self.0.borrow_mut();
        (state.forgets_files, state.forgets_names) = (files, names);
    }

    /// From now on nothing more can be written, or it can again; false if that is so already.
    pub fn set_full(&self, full: bool) -> bool {
        std::mem::replace(&mut self.0.borrow_mut().full, full) != full
    }

    /// Whoever works here is killed at the operation after this many.
    pub fn crash_in(&self, operations: u32) {
        self.0.borrow_mut().crash_in = Some(operations);
    }

    /// Whether it was; the next one works undisturbed.
    pub fn take_crash(&self) -> bool {
        let mut state = self.0.borrow_mut();
        state.crash_in = None;
        std::mem::take(&mut state.crashed)
    }

    /// Appends to a file, which is made if it is not there. Nothing of it is synchronised.
    pub fn append(&self, path: &Path, bytes: &[u8]) -> Result<()> {
        let mut state = self.0.borrow_mut();
        if state.full {
            return Err(ErrorKind::StorageFull.into());
        }
        let number = state.open_or_make(path);
        state.files[number].content.extend_from_slice(bytes);
        Ok(())
    }

    pub fn sync_whole(&self, path: &Path) -> Result<()> {
        let number = *self.0.borrow().names.get(path).ok_or(ErrorKind::NotFound)?;
        self.sync(&number)?;
        self.sync_folder(path.parent().unwrap_or(Path::new("")))
    }

    /// Cuts a file to a part of its length, as a tool or a bad sector would; false if there is none.
    pub fn tear(&self, path: &Path, dice: &mut Dice) -> bool {
        let mut state = self.0.borrow_mut();
        let Some(&number) = state.names.get(path) else { return false };
        let file = &mut state.files[number];
        let left = dice.below(file.content.len().max(1) as u32) as usize;
        file.content.truncate(left);
        file.synced = file.synced.min(left);
        true
    }

    /// The power fails, and is there again.
    pub fn lose_power(&self, dice: &mut Dice) {
        let mut state = self.0.borrow_mut();
        let pending = std::mem::take(&mut state.pending);
        let changed: BTreeSet<&PathBuf> = pending.iter().map(|(name, _)| name).collect();
        for name in changed {
            let changes: Vec<Option<usize>> =
                pending.iter().filter(|(other, _)| other == name).map(|&(_, file)| file).collect();
            // The first few of a name's changes had reached the disk.
            match changes[..dice.below(changes.len() as u32 + 1) as usize].last() {
                Some(Some(file)) => drop(state.durable.insert(name.clone(), *file)),
                Some(None) => drop(state.durable.remove(name)),
                None => {}
            }
        }
        for file in &mut state.files {
            let unsynced = file.content.len() - file.synced;
            let kept = file.synced + dice.below(unsynced as u32 + 1) as usize;
            if dice.once_in(4) {
                // The length had reached the disk, and not what was to be there.
                file.content[kept..].fill(0);
            } else {
                file.content.truncate(kept);
            }
            file.synced = file.content.len();
        }
        state.names = state.durable.clone();
        state.crash_in = None;
        state.crashed = false;
        state.full = false;
    }

    /// One more operation; an error once the process is dead.
    fn operate(&self) -> Result<()> {
        let mut state = self.0.borrow_mut();
        if let Some(left) = &mut state.crash_in {
            match left.checked_sub(1) {
                Some(fewer) => *left = fewer,
                None => state.crashed = true,
            }
        }
        if state.crashed { Err(Error::other("the process is dead")) } else { Ok(()) }
    }
}

impl State {
    fn open_or_make(&mut self, path: &Path) -> usize {
        if let Some(&number) = self.names.get(path) {
            return number;
        }
        self.files.push(File::default());
        let number = self.files.len() - 1;
        self.name(path, Some(number));
        number
    }

    fn name(&mut self, path: &Path, file: Option<usize>) {
        match file {
            Some(file) => drop(self.names.insert(path.to_path_buf(), file)),
            None => drop(self.names.remove(path)),
        }
        self.pending.push((path.to_path_buf(), file));
    }
}

impl Disk for SimulatedDisk {
    type File = usize;

    fn create_folders(&self, _folder: &Path) -> Result<()> {
        self.operate()
    }

    fn create_new(&self, path: &Path) -> Result<usize> {
        self.operate()?;
        let mut state = self.0.borrow_mut();
        if state.names.contains_key(path) {
            return Err(ErrorKind::AlreadyExists.into());
        }
        Ok(state.open_or_make(path))
    }

    fn open(&self, path: &Path) -> Result<usize> {
        self.operate()?;
        Ok(*self.0.borrow().names.get(path).ok_or(ErrorKind::NotFound)?)
    }

    fn write_all(&self, file: &mut usize, content: &[u8]) -> Result<()> {
        let killed = self.operate();
        let mut state = self.0.borrow_mut();
        let torn = killed.is_err() || state.full;
        let written = if torn { &content[..content.len() / 2] } else { content };
        state.files[*file].content.extend_from_slice(written);
        if state.full { Err(ErrorKind::StorageFull.into()) } else { killed }
    }

    fn sync(&self, file: &usize) -> Result<()> {
        self.operate()?;
        let mut state = self.0.borrow_mut();
        if !state.forgets_files {
            let file = &mut state.files[*file];
            file.synced = file.content.len();
        }
        Ok(())
    }

    fn sync_folder(&self, folder: &Path) -> Result<()> {
        self.operate()?;
        let mut state = self.0.borrow_mut();
        if state.forgets_names {
            return Ok(());
        }
        let (here, elsewhere) =
            std::mem::take(&mut state.pending).into_iter().partition(|(name, _)| name.parent() == Some(folder));
        state.pending = elsewhere;
        let here: Vec<(PathBuf, Option<usize>)> = here;
        for (name, file) in here {
            match file {
                Some(file) => drop(state.durable.insert(name, file)),
                None => drop(state.durable.remove(&name)),
            }
        }
        Ok(())
    }

    fn rename(&self, from: &Path, to: &Path) -> Result<()> {
        self.operate()?;
        let mut state = self.0.borrow_mut();
        let file = *state.names.get(from).ok_or(ErrorKind::NotFound)?;
        state.name(to, Some(file));
        state.name(from, None);
        Ok(())
    }

    fn remove(&self, path: &Path) -> Result<()> {
        self.operate()?;
        let mut state = self.0.borrow_mut();
        if !state.names.contains_key(path) {
            return Err(ErrorKind::NotFound.into());
        }
        state.name(path, None);
        Ok(())
    }

    fn read(&self, path: &Path, _most: u64) -> Result<Vec<u8>> {
        self.operate()?;
        let state = self.0.borrow();
        let file = *state.names.get(path).ok_or(ErrorKind::NotFound)?;
        Ok(state.files[file].content.clone())
    }

    fn size(&self, path: &Path) -> Result<u64> {
        Ok(self.read(path, u64::MAX)?.len() as u64)
    }

    fn list(&self, folder: &Path) -> Result<Vec<PathBuf>> {
        self.operate()?;
        Ok(self.0.borrow().names.keys().filter(|name| name.parent() == Some(folder)).cloned().collect())
    }
}
