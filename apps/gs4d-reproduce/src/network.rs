//! The network and the range of colours of a column of LPIPS.

use gs_metrics::{Lpips, LpipsNet, LpipsRange};
use serde::Deserialize;
use std::fmt;

/// What a column of LPIPS is measured with: `NET RANGE`, as `vgg 0..1` or `alex -1..1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct Network {
    /// The network.
    pub net: LpipsNet,
    /// What the network is given of colours.
    pub range: LpipsRange,
}

/// All of them, as tables name them.
const NETWORKS: [(&str, Network); 4] = [
    ("vgg 0..1", Network { net: LpipsNet::Vgg, range: LpipsRange::Unit }),
    ("vgg -1..1", Network { net: LpipsNet::Vgg, range: LpipsRange::Signed }),
    ("alex 0..1", Network { net: LpipsNet::Alex, range: LpipsRange::Unit }),
    ("alex -1..1", Network { net: LpipsNet::Alex, range: LpipsRange::Signed }),
];

impl TryFrom<String> for Network {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let names = || NETWORKS.map(|(name, _)| name).join(", ");
        let found = NETWORKS.into_iter().find(|(name, _)| *name == text);
        found.map(|(_, network)| network).ok_or_else(|| format!("`{text}` is none of {}", names()))
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(NETWORKS.iter().find(|(_, network)| network == self).map_or("", |(name, _)| name))
    }
}

impl Network {
    /// LPIPS in this range, with the weights of its network among these; `None` if there are none.
    pub(crate) fn among(self, weights: &[Lpips]) -> Option<Lpips> {
        weights.iter().find(|w| w.net() == self.net).map(|w| w.clone().with_range(self.range))
    }

    /// Its network alone, as `alex`.
    pub(crate) fn net_name(self) -> String {
        self.to_string().split(' ').next().unwrap_or_default().to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_metrics::testkit::{alex, file, vgg16};

    #[test]
    fn networks_are_read_as_tables_name_them() {
        for (name, network) in NETWORKS {
            assert_eq!(Network::try_from(name.to_owned()), Ok(network));
            assert_eq!(network.to_string(), name);
        }
        let error = Network::try_from("vgg".to_owned()).unwrap_err();
        assert!(error.contains("`vgg`") && error.contains("alex -1..1"), "{error}");
    }

    #[test]
    fn a_column_takes_the_weights_of_its_network_in_its_range() {
        let [alex, vgg] = [alex(), vgg16()].map(|shapes| Lpips::read(&file(&shapes)).unwrap());
        let unit = Network::try_from("vgg 0..1".to_owned()).unwrap();
        assert!(unit.among(std::slice::from_ref(&alex)).is_none());
        let found = unit.among(&[alex, vgg.clone()]).unwrap();
        assert_eq!(found.weights(), format!("{}, colours in [0, 1]", vgg.weights()));
        assert_eq!(unit.net_name(), "vgg");
    }
}
