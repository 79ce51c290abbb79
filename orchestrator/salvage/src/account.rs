const FINDINGS_MAX: usize = 64;

/// Name of the metadata record in which a file that was repaired carries what was lost: `outcome` in a few words, and
/// `finding-00` and so on.
pub const REPAIR_METADATA: &str = "stillroom.repair";

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Account {
    pub messages: u64,
    pub cut: bool,
    /// An earlier repair left its account in the file: it lost something then.
    pub repaired_with_loss: Option<String>,
    pub(crate) missing: u64,
    findings: Vec<String>,
    further: u64,
    lossy: bool,
}

impl Account {
    pub fn is_whole(&self) -> bool {
        self.findings.is_empty()
    }

    pub fn is_lossless(&self) -> bool {
        !self.lossy
    }

    pub fn outcome(&self) -> String {
        match self.missing {
            _ if !self.lossy => "nothing was lost".to_owned(),
            1 => "1 message lost".to_owned(),
            0 if self.cut => "what came after its end is lost".to_owned(),
            0 => "not all that was recorded is there".to_owned(),
            missing => format!("{missing} messages lost"),
        }
    }

    pub fn lines(&self) -> Vec<String> {
        let further = (self.further > 0).then(|| format!("and {} findings more", self.further));
        self.findings.iter().cloned().chain(further).collect()
    }

    pub(crate) fn find(&mut self, offset: u64, problem: &str, is_loss: bool) {
        self.lossy |= is_loss;
        if self.findings.len() < FINDINGS_MAX {
            let loss = if is_loss { "" } else { "; nothing was lost" };
            self.findings.push(format!("at byte {offset}: {problem}{loss}"));
        } else {
            self.further += 1;
        }
    }
}
